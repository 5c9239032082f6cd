"""Measures the beam: plays a burst and records velocity and drive at many positions, each on the disk at once.

``laboratory``  generator and scope together, simulated or real; outputs on only while a record is taken
``plan``        what is to be played, where, and how it is recorded
``scan``        the scan as it was recorded, frozen
``scanning``    takes a scan, or goes on with one that was stopped

A scan needs a few lines, whoever asks for it::

    plan = ScanPlan(burst, velocity=0.2, positions=np.linspace(-0.05, 0.05, 41), acquisition=Acquisition(...))
    with open_laboratory(apparatus) as laboratory:
        scan = take_scan(laboratory, plan, folder, source=Source.load(path))

Without a folder nothing is written. `Laboratory.record` measures one position alone.
"""

from modaltouch.lab.measurement.laboratory import SIMULATED, Laboratory, open_laboratory
from modaltouch.lab.measurement.plan import ScanPlan
from modaltouch.lab.measurement.scan import Scan, read_scan
from modaltouch.lab.measurement.scanning import keep_records, take_scan

__all__ = [
    "SIMULATED",
    "Laboratory",
    "Scan",
    "ScanPlan",
    "keep_records",
    "open_laboratory",
    "read_scan",
    "take_scan",
]
