"""Analysis of adaptive sessions: psychometric function of each run, thresholds, figures and report.

``psychometric``  fit with profile-likelihood intervals and a check for flat data
``runs``          runs from the answers; thresholds over participants
``figures``       track and fitted function of each run; thresholds of all runs
``analysis``      analyse_runs, render_runs: table, figures, report
"""

from modaltouch.analysis.thresholds.analysis import ThresholdAnalysis, analyse_runs, render_runs

__all__ = ["ThresholdAnalysis", "analyse_runs", "render_runs"]
