"""Summary of a run, as in ``summary.json``.

- ``run_summary``  figures of all steps
- ``budget``       error budget
- ``savings``      work that the steps left out
"""

from metafab.steps.summary.budget import error_budget
from metafab.steps.summary.run_summary import SUMMARY_FILE, UNCHANGED, BudgetLine, RunSummary, Saving, SkippedStep
from metafab.steps.summary.savings import savings

__all__ = [
    "SUMMARY_FILE",
    "UNCHANGED",
    "BudgetLine",
    "RunSummary",
    "Saving",
    "SkippedStep",
    "error_budget",
    "savings",
]
