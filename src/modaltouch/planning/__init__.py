"""How many participants: the very protocol, simulated by the thousand and analysed as the real data will be.

``design``        the cells of a design, and what fingers feel in them
``presented``     what a protocol presents to an observer: its design
``significance``  the exact tests, thousands at once
``precision``     widths of the intervals, thousands at once
``questions``     the families of tests, as in the analysis
``floors``        the fewest participants with whom anything can be significant
``experiments``   participants and answers drawn, significant tests counted, job by job
``power``         plan: all jobs -> Power
``workers``       jobs shared among processes, or on a dask cluster
``pictures``      contours of power over participants and repetitions
``writing``       tables and pictures into a folder
``fitting``       an observer fitted to recorded answers
"""
