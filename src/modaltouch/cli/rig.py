"""``modaltouch rig``: find, check and simulate the instrument."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modaltouch.cli import APPARATUS, JSON, SEED_OF_TWIN, SHIPPED_APPARATUS, print_json, reporting

rig = typer.Typer(
    name="rig",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="Find, check and simulate the generator.",
)


@rig.command("list")
def list_addresses(json_output: JSON = False) -> None:
    """List the VISA addresses of the instruments that this machine can see."""
    from modaltouch.rig import find_instruments

    with reporting(json_output=json_output):
        addresses = find_instruments()
        if json_output:
            print_json({"addresses": list(addresses)})
        else:
            print(
                "\n".join(addresses)
                or "none found; a generator on the network is not listed but answers at TCPIP::<its address>::INSTR"
            )


@rig.command("check")
def check(
    address: Annotated[str, typer.Argument(help="VISA address, or `simulated`.", show_default=False)],
    apparatus: APPARATUS = SHIPPED_APPARATUS,
    scope: Annotated[
        bool, typer.Option("--scope", help="Measure the trigger's latency with a PicoScope at the trigger output.")
    ] = False,
    json_output: JSON = False,
) -> None:
    """Test what a generator does where its manual is silent, and whether it is fit for a session.

    Nothing is played: the outputs stay off, unless a question says otherwise.
    """
    from contextlib import ExitStack

    from modaltouch.protocol import Apparatus
    from modaltouch.rig import Scope, Simulator, check_rig

    with reporting(json_output=json_output), ExitStack() as stack:
        parts = Apparatus.read(apparatus)
        listens: Scope | None = None
        if address == "simulated":
            simulator = stack.enter_context(Simulator(parts))
            address, listens = simulator.address, simulator.scope()
        elif scope:
            listens = stack.enter_context(Scope.open(parts))
        rows = check_rig(address, parts, scope=listens)
        if json_output:
            print_json({"address": address, "rows": rows})
        else:
            for row in rows:
                print(f"{row['number']:2d}  {row['question']}\n    {row['answer']}\n    -> {row['advice']}")


@rig.command("simulate")
def simulate(
    apparatus: APPARATUS = SHIPPED_APPARATUS,
    port: Annotated[int, typer.Option(min=0, max=65535, help="TCP port on this machine; 0 for any free one.")] = 0,
    seed: SEED_OF_TWIN = None,
    played: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Append a JSON line for each burst when it ends.", show_default=False),
    ] = None,
    follow: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG", help="Log of the session whose finger placements the rig follows.", show_default=False
        ),
    ] = None,
) -> None:
    """Run a simulated rig for other programs on this machine, until it is interrupted.

    The first line on standard output is its VISA address, the second that of its raw socket. `--played` records each
    burst: `start_s` and `end_s` on this machine's monotonic clock, whether the burst is `whole`, `amplitude_Vpp` of
    both outputs, the peak speed `zone_peak_mm_s` at each zone's centre, and the `link` that triggered it: 0 for the
    front panel, null for a burst without a trigger. With `--follow FOLDER/session.jsonl`, which may begin later,
    fingers are placed as in that session, and `finger_peak_mm_s` is the peak speed under each.
    """
    from modaltouch.protocol import Apparatus
    from modaltouch.rig import Simulator

    with reporting():
        Simulator(Apparatus.read(apparatus), seed, port=port, played=played, follow=follow).serve()
