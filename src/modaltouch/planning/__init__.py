"""How many participants: the very protocol, simulated by the thousand and analysed as the real data will be.

``design``        the cells of a design, and what fingers feel in them
``presented``     what a protocol presents to an observer: its design
``significance``  the exact tests, thousands at once
``questions``     the families of tests and the widths of intervals, as in the analysis
``experiments``   participants and answers drawn, significant tests counted, job by job
``power``         plan: all jobs -> Power; the fewest participants that can tell anything
``pictures``      contours of power over participants and repetitions
``writing``       tables and pictures into a folder
``fitting``       an observer fitted to recorded answers
"""
