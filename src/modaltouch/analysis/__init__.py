"""From records to tables, statistics, figures and the report; needs neither instrument nor screen.

``reading``      answers from a tidy CSV (``csv_table``, ``balance``) or a tree of sessions (``results_tree``)
``responses``    what they are, once read
``counts``       answers as one array; ``tables``: as tables, in the form of Fig. 10 and Fig. 11
``exact``        exact tests by convolution (``convolution``, ``trend``); ``shuffles``: Monte Carlo ones
``intervals``    intervals that hold when every answer is the same; ``agreement``: Gwet's AC1
``statistics``   the questions of the plan (``consistency``, ``secondary``), as rows of ``findings``
``figures``      bars, overview, participants (``courses``, ``gallery``, ``style``)
``report``       one HTML file; ``record_facts``: what the session logs add to it
``analyse``      the whole of it (``outcome``), written to a folder (``output``)
"""
