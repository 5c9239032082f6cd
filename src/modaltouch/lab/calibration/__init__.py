"""Corrects the targets of a stimulus until the rig does at the focusing instant what was asked for.

No record tells the time from the generator's first sample to the scope's, its trigger latency: of the shipped stimulus
every 0.05 us that `acquisition.trigger_latency_us` misses of it leave 0.08 mm/s in a displacement.
"""
