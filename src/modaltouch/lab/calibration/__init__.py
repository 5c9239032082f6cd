"""Corrects the targets of a stimulus until the rig produces the target field at the focusing instant.

No record reveals the trigger latency, the time from the generator's first sample to the scope's. With the shipped
stimulus each 0.05 us of error in `acquisition.trigger_latency_us` leaves an error of 0.08 mm/s in a displacement.
"""
