"""From a YAML protocol to the statistics of the paper: a haptics experiment on a vibrating beam.

The stages, in the order in which values flow through them:

``document``   reads YAML with the place of every value
``apparatus``  YAML -> Apparatus: beam, zones, modes, actuator sets, amplifier, generator
``protocol``   YAML -> Protocol: what is presented, asked and repeated
``stimulus``   modal synthesis: wished velocity field -> voltages -> codes -> predicted field
``trial``      Trial (what is asked) and Response (what is answered)
``schedule``   Protocol + participant + seed -> Schedule of Blocks of Trials
``preflight``  everything that can fail before the participant sits down
``rig``        plays the burst: an AFG3022B over PyVISA, or its simulated twin behind the same driver
``window``     asks the question: a PsychoPy window, or a simulated participant
``record``     the append-only session log and its BIDS view
``session``    the one loop
``analysis``   records -> tables, statistics, figures, report
"""

__version__ = "0.1.0"
