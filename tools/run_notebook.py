"""Run a notebook's code cells in order and store their outputs in it; does not need Jupyter.

    python -m tools.run_notebook examples/tutorial.ipynb

The outputs are what a cell prints to standard output, then the value of its last expression: Pillow
images as PNG, anything else as text.
"""

import ast
import base64
import contextlib
import io
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from magical.files import write_atomically


def read_notebook(path: Path) -> dict[str, Any]:
    """A notebook as plain data (nbformat 4)."""
    notebook: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return notebook


def run_notebook(notebook: Mapping[str, Any]) -> None:
    """Run the code cells in one namespace, replacing their outputs in place."""
    names: dict[str, Any] = {"__name__": "__main__"}
    code_cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for number, cell in enumerate(code_cells, 1):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            value = run_cell("".join(cell["source"]), f"<cell {number}>", names)
        cell["execution_count"] = number
        cell["outputs"] = _outputs(printed.getvalue(), value, number)


def run_cell(source: str, name: str, names: dict[str, Any]) -> Any:
    """Execute a cell's code; returns the value of its last statement if that is an expression."""
    module = ast.parse(source, name)
    last = module.body[-1] if module.body else None
    if not isinstance(last, ast.Expr):
        exec(compile(module, name, "exec"), names)  # noqa: S102  (the repository's own notebook)
        return None
    module.body.pop()
    exec(compile(module, name, "exec"), names)  # noqa: S102
    return eval(compile(ast.Expression(last.value), name, "eval"), names)  # noqa: S307


def _outputs(printed: str, value: Any, number: int) -> list[dict[str, Any]]:
    outputs: list[dict[str, Any]] = []
    if printed:
        text = printed.splitlines(keepends=True)
        outputs.append({"output_type": "stream", "name": "stdout", "text": text})
    if value is not None:
        outputs.append(
            {
                "output_type": "execute_result",
                "execution_count": number,
                "metadata": {},
                "data": _data(value),
            }
        )
    return outputs


def _data(value: Any) -> dict[str, Any]:
    """A value by media type."""
    if hasattr(value, "_repr_png_"):
        file = io.BytesIO()
        value.save(file, "PNG", optimize=True)
        image = base64.b64encode(file.getvalue()).decode()
        return {"image/png": image, "text/plain": f"<image of {value.width} x {value.height}>"}
    return {"text/plain": repr(value)}


def main(paths: list[str]) -> int:
    for path in map(Path, paths):
        notebook = read_notebook(path)
        run_notebook(notebook)
        with write_atomically(path) as file:
            file.write((json.dumps(notebook, indent=1, ensure_ascii=False) + "\n").encode())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
