"""The experimenter's side of a session, while the window belongs to the participant.

``interface``     what a console shows, and what can be requested at it
``status``        the session's events -> its state, as plain values with units
``experimenter``  the experimenter's requests, kept until the session acts upon them
``consoles``      the session's side: the console in the terminal, JSON lines, or plain lines if there is no terminal
``__main__``      the terminal's side, a separate process: draws, and reads keys (``drawing``, ``keyboard``)

Drawing and reading keys take place in a separate process. Drawing the terminal takes about ten milliseconds of
Python; a thread would delay the window's polls by as much, and falsify reaction times. If either process is killed,
the other one restores the terminal.
"""
