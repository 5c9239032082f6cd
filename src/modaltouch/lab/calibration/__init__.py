"""Calibration: what the stimulus really does at the focusing instant, and targets that make it what was wished.

``bursts``    what is played to identify the rig
``taking``    records with ranges that fit
``lag``       gain, delay and lag of the drive; the scope's clock; delay and lag of the vibrometer
``decay``     poles and residues of free decays, unlisted modes included
``plant``     the identified rig, and states read off decays
``refining``  from what was measured to what is aimed at
``loop``      identify, aim, measure, correct, verify
``outcome``   what comes of it
``writing``   the file that the session reads

No record tells the time from the generator's first sample to the scope's, its trigger latency: of the shipped stimulus
every 0.05 us that `acquisition.trigger_latency_us` misses of it leave 0.08 mm/s in a displacement.
"""
