"""Tables, pictures and the page."""

from magical.report.contact_sheet import contact_sheet

__all__ = ["contact_sheet"]
