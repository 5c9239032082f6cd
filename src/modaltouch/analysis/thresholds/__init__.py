"""Adaptive sessions: each run's psychometric function, or why it has none; figures and report.

``psychometric``  fit, interval by profile likelihood, guard against flat data
``runs``          runs from the answers; thresholds over participants
``figures``       track and fitted function of each run; thresholds of all
``analysis``      analyse_runs, render_runs: table, figures, report
"""

from modaltouch.analysis.thresholds.analysis import ThresholdAnalysis, analyse_runs, render_runs

__all__ = ["ThresholdAnalysis", "analyse_runs", "render_runs"]
