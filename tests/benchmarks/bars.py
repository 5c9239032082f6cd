"""The project's promises of speed and accuracy, each with the measured value.

As a script: prints the promises in every file in results/benchmarks/.
"""

import json
import os
import platform
import sys
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).resolve().parents[2] / "results" / "benchmarks"


def at_least(what: str, measured: float, bar: float, unit: str = "x") -> dict[str, Any]:
    """Return the promise that a figure reaches a bar; a ratio has the unit `x`."""
    met = bool(measured >= bar)
    return {"what": what, "unit": unit, "measured": float(measured), "allowed": "at least", "bar": bar, "met": met}


def at_most(what: str, measured: float, bar: float, unit: str = "x") -> dict[str, Any]:
    """Return the promise that a figure does not exceed a bar; a ratio has the unit `x`."""
    met = bool(measured <= bar)
    return {"what": what, "unit": unit, "measured": float(measured), "allowed": "at most", "bar": bar, "met": met}


def machine() -> dict[str, Any]:
    """Return a description of the machine on which the figures were measured."""
    import numpy as np
    import scipy
    from threadpoolctl import threadpool_info

    blas = [each for each in threadpool_info() if each.get("user_api") == "blas"]
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load_average": round(os.getloadavg()[0], 2),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "blas": sorted({f"{each['internal_api']} {each['version']}, {each.get('architecture')}" for each in blas}),
        "blas_threads": 1,
    }


def _processor() -> str:
    """Return the name of the processor."""
    listed = Path("/proc/cpuinfo")
    lines = listed.read_text(encoding="utf-8").splitlines() if listed.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def write(name: str, results: dict[str, Any], bars: list[dict[str, Any]]) -> int:
    """Write the results to ``results/benchmarks/NAME.json`` and print their promises."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    whole = {"machine": machine(), "bars": bars, **results}
    (RESULTS / f"{name}.json").write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    show(bars)
    return 0


def show(bars: list[dict[str, Any]]) -> None:
    """Print one promise per line: whether it is met, the measured value, the bar and the subject."""
    for each in bars:
        verdict = "met    " if each["met"] else "NOT MET"
        figures = f"{each['measured']:.3g} ({each['allowed']} {each['bar']:.4g}) {each['unit']}"
        print(f"  {verdict} {figures:34} {each['what']}")


def main() -> int:
    """Print all promises; return 1 if any is not met."""
    unmet = 0
    for path in sorted(RESULTS.glob("*.json")):
        bars = json.loads(path.read_text(encoding="utf-8")).get("bars", [])
        if isinstance(bars, list) and bars:
            print(path.name)
            show(bars)
            unmet += sum(not each["met"] for each in bars)
    print(f"{unmet} not met" if unmet else "all met")
    return int(unmet > 0)


if __name__ == "__main__":
    sys.exit(main())
