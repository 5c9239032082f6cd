"""The experimenter's side of a session, while the window belongs to the participant.

``interface``     what a console is told, and what can be asked at it
``status``        the session's events -> how it stands, as plain values with units
``experimenter``  what was asked, for the session to act upon
``consoles``      the session's end: the console in the terminal, JSON lines, or plain lines where there is no terminal
``__main__``      the terminal's end, a process of its own: draws, and reads keys (``drawing``, ``keyboard``)

Drawing and reading keys take place in a process of their own. A picture of the terminal takes some ten
milliseconds of Python; a thread would take them from the window's poll, and so from every reaction time. And
whichever of the two processes is killed, the other one gives the terminal back as it was.
"""
