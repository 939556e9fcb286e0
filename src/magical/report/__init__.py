"""Tables, figures and the page; from files alone."""

from magical.report.figures.contact_sheet import contact_sheet
from magical.report.pages.page import Page
from magical.report.scores.tables import Table, entry_tasks, task_table, text_rows

__all__ = ["Page", "Table", "contact_sheet", "entry_tasks", "task_table", "text_rows"]
