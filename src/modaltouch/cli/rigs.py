"""``modaltouch rig``: find, check and simulate the instrument."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modaltouch.cli.faults import print_json, reporting

app = typer.Typer(no_args_is_help=True, help="Find, check and simulate the generator.")

APPARATUS = Annotated[Path, typer.Option("--apparatus", help="Apparatus, a YAML file.")]


@app.command("list")
def list_addresses(
    json_output: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
) -> None:
    """List the VISA addresses of the instruments that this machine can see."""
    from modaltouch.rig.generator import find_instruments

    with reporting(json_output=json_output):
        addresses = find_instruments()
        if json_output:
            print_json({"addresses": list(addresses)})
        elif addresses:
            print("\n".join(addresses))
        else:
            print(
                "none found; a generator on the network is not listed but answers at TCPIP::<its address>::INSTR"
            )
