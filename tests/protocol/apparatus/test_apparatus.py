"""The apparatus file: values, faults, and conversion to SI units."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.source import InputError

Edit = Callable[..., Path]
FILE = "apparatus/beam_100x6x2.yaml"


@pytest.fixture
def apparatus(shipped: Path) -> Apparatus:
    """The shipped apparatus."""
    return Apparatus.read(shipped / FILE)


def test_the_shipped_file_is_table_1(apparatus: Apparatus) -> None:
    """Natural frequencies and damping ratios as printed in Table I of the paper."""
    table = {
        1: (229, 0.0437),
        3: (2553, 0.0165),
        5: (7137, 0.0265),
        7: (12701, 0.0168),
        9: (22810, 0.0112),
        11: (29390, 0.0166),
        13: (58303, 0.0101),
        15: (68543, 0.0176),
        17: (87855, 0.0147),
    }
    read = {mode.label: (mode.natural_frequency_Hz, mode.damping_ratio) for mode in apparatus.modes}
    assert read == table


def test_the_model_is_in_si_units(apparatus: Apparatus) -> None:
    """Table I gives mode 13 a gain of 41448 mm/(s V), i.e. 41.448 m/s^2 per V; the beam is 100 mm long."""
    model = apparatus.modal_model()
    row = model.label.index(13)
    assert model.length == pytest.approx(0.1, rel=1e-15)
    assert model.natural_frequency[row] == 58303
    np.testing.assert_allclose(model.modal_gain[row], [-41.448, 0.0], rtol=1e-15)


def test_gains_are_in_the_column_of_their_channel(edit: Edit) -> None:
    """Swapping the outputs swaps the columns."""
    swapped = edit(FILE, ("centre: {channel: 1}", "centre: {channel: 2}"), ("side: {channel: 2}", "side: {channel: 1}"))
    model = Apparatus.read(swapped).modal_model()
    np.testing.assert_allclose(model.modal_gain[model.label.index(5)], [6.5, 0.0], rtol=1e-15)
    np.testing.assert_allclose(model.modal_gain[model.label.index(1)], [0.0, 0.114], rtol=1e-15)


def test_the_amplifier_is_in_si_units(edit: Edit) -> None:
    """100 kHz and 4.6 us become 1e5 Hz and 4.6e-6 s."""
    file = edit(FILE, ("bandwidth_kHz: null", "bandwidth_kHz: 100"), ("delay_us: 0", "delay_us: 4.6"))
    values = Apparatus.read(file).amplifier_values()
    assert (values.gain, values.limit) == (25, 250)
    assert values.bandwidth == pytest.approx(1e5, rel=1e-15)
    assert values.delay == pytest.approx(4.6e-6, rel=1e-15)


def test_unknown_and_assumed_gains_are_listed(apparatus: Apparatus) -> None:
    """Table I gives each mode one actuator set; for modes 9, 15 and 17 the set is an assumption."""
    assert len(apparatus.unknown_gains()) == 9
    assert (1, "side") in apparatus.unknown_gains()
    assert apparatus.assumed_gains() == ((9, "side"), (15, "side"), (17, "side"))


def test_zones_are_ordered_by_position(edit: Edit) -> None:
    """Exchanging A and E reverses their order."""
    file = edit(FILE, ("A: {centre_mm: -40", "A: {centre_mm: 40"), ("E: {centre_mm: 40", "E: {centre_mm: -40"))
    assert list(Apparatus.read(file).ordered_zones) == ["E", "B", "C", "D", "A"]


def test_a_50_ohm_load_halves_the_open_circuit_voltage(edit: Edit) -> None:
    """Voltage divider of 50 ohm output and 50 ohm load."""
    assert Apparatus.read(edit(FILE, ("load: high_impedance", "load: 50_ohm"))).generator.load_factor == 0.5


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("width_mm: 6", "width_cm: 6", r":8:3: beam.width_cm: .*did you mean 'width_mm'"),
        (
            "E: {centre_mm: 40",
            "E: {centre_mm: 45",
            r":18:3: zones.E: given a zone from 35 to 55 mm; allowed: from -50 to",
        ),
        ("D: {centre_mm: 20", "D: {centre_mm: 15", r":17:3: zones.D: given a zone that begins at 5 mm, inside zone C"),
        (
            "side: {channel: 2}",
            "side: {channel: 1}",
            r":22:19: actuator_sets.side.channel: given 1, which already feeds the set",
        ),
        (
            "side: {channel: 2}",
            "side: {channel: 3}",
            r":22:19: .*given 3; allowed: a whole number of at least 1, at most",
        ),
        ("{centre: 114}", "{center: 114}", r":27:85: modes\[0\].gain_mm_s2_per_V.center: .* did you mean 'centre'"),
        ("{centre: 114}", "{}", None),
        ("label: 3,", "label: 1,", r":28:13: modes\[1\].label: given 1, which is also the label of modes\[0\]"),
        (
            "assumed: [side]}\n  - {label: 11",
            "assumed: [centre]}\n  - {label: 11",
            r"modes\[4\].assumed\[0\]: given 'centre'",
        ),
        (
            "damping_ratio: 0.0437",
            "damping_ratio: 4.37",
            r"modes\[0\].damping_ratio: given 4.37; allowed: a number above 0, below 1",
        ),
        ("damping_ratio: 0.0437", "damping_ratio: 0", r"modes\[0\].damping_ratio: given 0"),
        (
            "natural_frequency_Hz: 229",
            "natural_frequency_Hz: .inf",
            r"given .inf, which is not finite; allowed: a number \[Hz\]",
        ),
        (
            "apparatus: beam_100x6x2",
            "apparatus: ../beam",
            r":3:12: apparatus: given '../beam', which is not a plain file name",
        ),
        ("limit_V: 250", "limit_V: 250 V", r"write only the number: 250"),
        ("load: high_impedance", "load: 50", r"generator.load: given 50; allowed: high_impedance, 50_ohm"),
        ("velocity_limit_mm_s: 500", "velocity_limit_mm_s: -1", r"safety.velocity_limit_mm_s: given -1"),
    ],
)
def test_each_fault_has_its_position(edit: Edit, old: str, new: str, fault: str | None) -> None:
    """Lines and columns of the shipped file; a mode with no known gain is not a fault."""
    file = edit(FILE, (old, new))
    if fault is None:
        assert Apparatus.read(file).modal_model().modal_gain[0].tolist() == [0.0, 0.0]
        return
    with pytest.raises(InputError, match=fault) as caught:
        Apparatus.read(file)
    assert len(caught.value.problems) == 1


def test_faults_of_all_sections_are_reported_together(edit: Edit) -> None:
    """Five sections with one fault each give five problems."""
    file = edit(
        FILE,
        ("length_mm: 100", "length_mm: long"),
        ("B: {centre_mm: -20", "B: {centre_mm: -25"),
        ("side: {channel: 2}", "side: {channel: 1}"),
        ("label: 3,", "label: 1,"),
        ("gain_V_per_V: 25", "gain_V_per_V: 0"),
    )
    with pytest.raises(InputError) as caught:
        Apparatus.read(file)
    sections = [problem.path.split(".")[0].split("[")[0] for problem in caught.value.problems]
    assert sections == ["beam", "zones", "actuator_sets", "modes", "amplifier"]


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (
            "{label: 18, natural_frequency_Hz: 98000",
            "{label: 17, natural_frequency_Hz: 98000",
            r"twin.unlisted_modes\[8\].label: given 17, which is also the label of modes\[8\]; allowed: each mode once",
        ),
        (
            "{label: 18, natural_frequency_Hz: 98000",
            "{label: 16, natural_frequency_Hz: 98000",
            r"twin.unlisted_modes\[8\].label: given 16, which is also the label of twin.unlisted_modes\[7\]",
        ),
        ("{side: 150}, label: 1", "{sides: 150}, label: 1", r"twin.unlisted_modes\[10\].*'sides'.*did you mean 'side'"),
        (
            "family: torsion, natural_frequency_Hz: 8700",
            "family: twist, natural_frequency_Hz: 8700",
            "bending, torsion",
        ),
        ("bits: 8", "bits: 8.5", r"twin.scope.bits: given 8.5; allowed: a whole number of at least 4"),
        ("fingers: null", "fingers: {mass_g: 0.1}", r"twin.fingers.damping_N_s_per_m"),
        ("probe_attenuation: 100", "probe_attenuation: 0", r"acquisition.probe_attenuation: given 0"),
        ("trigger_jitter_ns: 2", "trigger_jitter_ns: .nan", r"twin.scope.trigger_jitter_ns: given"),
    ],
)
def test_faults_of_the_twin_have_their_position(edit: Edit, old: str, new: str, fault: str) -> None:
    """Modes listed twice, unknown actuator sets and invalid numbers are refused."""
    with pytest.raises(InputError, match=fault):
        Apparatus.read(edit(FILE, (old, new)))


def test_torsion_and_bending_modes_may_share_a_number(apparatus: Apparatus) -> None:
    """Torsion 1 and bending 1 are different modes; the shipped twin has both."""
    families = {mode.family for mode in apparatus.twin.unlisted_modes if mode.label in (1, 3)}
    assert families == {"torsion"}


def test_an_apparatus_without_a_twin_has_an_ideal_beam(edit: Edit, apparatus: Apparatus) -> None:
    """Without the section there are no further modes, mismatches or fingers, and the amplifier is as listed."""
    file = edit(FILE)
    text = file.read_text(encoding="utf-8")
    file.write_text(text[: text.index("twin:  ")], encoding="utf-8")
    twin = Apparatus.read(file).twin
    assert twin.unlisted_modes == ()
    assert twin.natural_frequency_mismatch == twin.gain_mismatch == twin.generator_gain_mismatch == 0
    assert (twin.fingers, twin.amplifier.bandwidth_kHz, twin.amplifier.delay_us) == (None, None, None)
    assert apparatus.twin.unlisted_modes != ()
