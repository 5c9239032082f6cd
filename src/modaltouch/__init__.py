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
``observer``   models of a participant, for simulated sessions and for planning
``record``     the append-only session log and its BIDS view
``session``    the one loop
``sitting``    sets a session up and ends it in order, new or resumed
``wiring``     puts real or simulated parts behind the session's interfaces
``analysis``   records -> tables, statistics, figures, report
``planning``   how many participants, by simulating the very protocol
``cli``        the command line
"""

__version__ = "0.1.0"
