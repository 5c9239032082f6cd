"""What `modaltouch identify` is to find: checked before anything is opened, measured or read, fitted, written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from modaltouch.cli.measuring import bars
from modaltouch.cli.progress import progress

if TYPE_CHECKING:
    from modaltouch.apparatus import Apparatus
    from modaltouch.document import Source
    from modaltouch.identification.responses import FrequencyResponses
    from modaltouch.measurement import Scan


class Wanted:
    """What is to be identified, checked before anything is opened."""

    def __init__(self, path: Path, sets: list[str] | None, modes: str, folder: Path | None) -> None:
        from modaltouch.apparatus import read_apparatus
        from modaltouch.document import load_source

        self.source: Source = load_source(path)
        self.apparatus: Apparatus = read_apparatus(path)
        self.sets = tuple(sets or self.apparatus.actuator_sets)
        self.folder = folder
        strange = next((name for name in self.sets if name not in self.apparatus.actuator_sets), None)
        if strange is not None:
            known = ", ".join(self.apparatus.actuator_sets)
            raise ValueError(f"'{strange}' is not an actuator set of {path}: name one of {known}")
        self.modes = modes
        self.labels = self._labels(modes)
        self.length = self.apparatus.beam.length_mm * 1e-3

    def _labels(self, modes: str) -> tuple[int, ...]:
        """Return the labels that must be found; with ``all``, those that the table lists."""
        if modes in ("listed", "all"):
            return tuple(mode.label for mode in self.apparatus.modes)
        try:
            labels = tuple(sorted({int(word) for word in modes.split(",")}))
        except ValueError:
            labels = ()
        if not labels or labels[0] < 1:
            raise ValueError(f"--modes is '{modes}': give `listed`, `all`, or labels from 1 on, as 1,3,5")
        return labels

    def measure(
        self,
        rig: str,
        out: Path,
        points: int,
        averages: int,
        voltage: float,
        excitation: Any,
        highest_kHz: float | None,
        margin: float,
        seed: int | None,
    ) -> dict[str, Scan]:
        """Return the scans of a rig, new or gone on with."""
        import numpy as np

        from modaltouch.analysis.output import refuse_other
        from modaltouch.identification.excitation import Campaign, evenly, excite, highest_needed
        from modaltouch.identification.report import COMMAND
        from modaltouch.identification.shapes import check_points
        from modaltouch.interruption import Interrupted, Interruption
        from modaltouch.measurement import open_laboratory

        refuse_other(out, COMMAND)
        positions = evenly(self.length, points, margin)
        check_points(np.array(positions), self.labels, self.length)
        highest = highest_needed(self.apparatus) if highest_kHz is None else highest_kHz * 1e3
        campaign = Campaign(positions, averages, voltage, highest, self.sets, excitation)
        for name in self.sets:
            excite(self.apparatus, name, voltage, highest, "chirp")
        done = [0, 0]
        with Interruption() as interruption, bars() as showing:

            def show(n: int, total: int) -> None:
                done[:] = n, total
                showing("points measured", n, total)

            try:
                with open_laboratory(
                    self.apparatus, rig, seed=seed, repetition="continuous", aim=showing.aim
                ) as laboratory:
                    scans = campaign.scan(laboratory, self.source, out, on_progress=show, check=interruption.check)
            except Interrupted as error:
                error.add_note(f"{done[0]} of {done[1]} points are kept in {out}; give the same command to go on")
                raise
        return scans

    def read(self) -> dict[str, Scan]:
        """Return the scans of a folder."""
        from modaltouch.measurement import read_scan

        folder = self.folder or Path()
        scans = {}
        for name in self.sets:
            place = folder / f"scan_{name}"
            if not place.is_dir():
                raise ValueError(
                    f"{folder}: holds no scan of the actuator set {name} ({place.name} is missing); measure it, or "
                    "name the sets that were measured with --set"
                )
            scans[name] = read_scan(place)
        return scans

    def reduced(self, scans: dict[str, Scan], place: Path) -> tuple[FrequencyResponses, dict[str, Any]]:
        """Return the responses of scans, and what is to be known of their measurement."""
        from modaltouch.identification.excitation import LOWEST
        from modaltouch.identification.responses import responses_of

        responses = responses_of(scans, self.bandwidth)
        first = next(iter(scans.values())).facts
        facts = {
            "date": first["begun"],
            "mode": first["mode"],
            "source": place.as_posix(),
            "generator": first["settings"]["generator"],
            "scope": first["settings"]["scope"],
            "method": f"{first['settings']['about']['stimulus']}, H1 by the measured drive, joint fit of all responses",
        }
        return responses.between(1.5 * LOWEST, float(responses.frequency[-1])), facts

    def chosen(self, responses: FrequencyResponses) -> FrequencyResponses:
        """Return the responses of the wanted actuator sets, which a file names."""
        import dataclasses

        missing = [name for name in self.sets if name not in responses.sets]
        if missing:
            raise ValueError(
                f"the files hold responses to {', '.join(responses.sets)}, none to the actuator set {missing[0]}: name "
                "the sets in the files as in the apparatus file, or those that were measured with --set"
            )
        rows = [responses.sets.index(name) for name in self.sets]
        coherence = None if responses.coherence is None else responses.coherence[rows]
        return dataclasses.replace(
            responses,
            response=responses.response[rows],
            coherence=coherence,
            sets=self.sets,
            bandwidth=self.bandwidth,
        )

    @property
    def bandwidth(self) -> float | None:
        """Corner of the vibrometer's low-pass [Hz]."""
        kilohertz = self.apparatus.acquisition.vibrometer_bandwidth_kHz
        return None if kilohertz is None else kilohertz * 1e3

    def fit(self, responses: FrequencyResponses, facts: dict[str, Any], out: Path) -> dict[str, Any]:
        """Return the identification as plain values, its files written."""
        from modaltouch.analysis.output import refuse_other
        from modaltouch.identification.apparatus_file import identified_apparatus
        from modaltouch.identification.excitation import CLOCK_TOLERANCE
        from modaltouch.identification.identified import identify as identify_responses
        from modaltouch.identification.report import COMMAND, as_dict, check_modes, write_identification
        from modaltouch.identification.shapes import check_points

        refuse_other(out, COMMAND)
        if responses.positions is not None:
            check_points(responses.positions, self.labels, self.length)
        with progress("fitting", counted=False):
            found = identify_responses(responses, self.length, clock_tolerance=CLOCK_TOLERANCE)
        check_modes(found, self.labels)
        labels = self.labels
        if self.modes == "all":
            labels = tuple(mode.label for mode in found.modes if mode.label is not None)
        name, text = identified_apparatus(self.source, found, labels, facts)
        written = write_identification(out, found, (name, text), {"sources": facts["source"]})
        return {
            **as_dict(found),
            "mode": facts["mode"],
            "table_modes": list(labels),
            "apparatus_file": str(written[name]),
            "files": {key: str(path) for key, path in written.items()},
        }
