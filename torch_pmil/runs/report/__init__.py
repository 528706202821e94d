"""A run on one page that needs nothing else: numbers, pictures, video, and where they come from."""

from torch_pmil.runs.report.page import write_report

__all__ = ["write_report"]
