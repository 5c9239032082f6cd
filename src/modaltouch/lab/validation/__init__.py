"""Shows what a drive does to a beam, as the paper does in Fig. 2 and 5 to 8, for both drive laws side by side.

``recording``   plays each law and records the field around the focus, and the zones throughout
``evidence``    what the recordings show beside what was wished and predicted
``measures``  widths, durations, contrast
``key_figures``, ``words``, ``pictures``, ``courses``, ``page``  the evidence as numbers, sentences, figures, one page
"""
