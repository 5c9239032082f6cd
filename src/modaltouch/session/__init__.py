"""A session of one participant, from its set-up to its verified record.

In come a checked experiment, a participant and a place for the record; out come the record and, meanwhile, its events.
``wiring`` puts the parts together, ``setup`` opens and closes them in order, ``loop`` runs the trials.
"""
