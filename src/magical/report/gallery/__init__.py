"""The gallery: a static site of all registered environments.

- `descriptions`: a task's scoring rule and variation from its docstring; scenes in words.
- `previews`: scenes and the scripted experts' rollouts as image files.
- `site`: the page and its folder.
"""

from magical.report.gallery.previews import EnvPreview, make_previews
from magical.report.gallery.site import check_site, write_gallery

__all__ = ["EnvPreview", "check_site", "make_previews", "write_gallery"]
