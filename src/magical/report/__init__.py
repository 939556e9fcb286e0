"""Tables, figures and the page; from files alone."""

from magical.report.contact_sheet import contact_sheet
from magical.report.page import Page
from magical.report.tables import Table, entry_tasks, task_table, text_rows

__all__ = ["Page", "Table", "contact_sheet", "entry_tasks", "task_table", "text_rows"]
