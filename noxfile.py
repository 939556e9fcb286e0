"""The tests on each supported Python that this machine has, without PyTorch (`make test-all`).

`make test` runs what needs PyTorch; this shows that nothing else does.
"""

import nox

nox.options.error_on_missing_interpreters = False
nox.options.reuse_existing_virtualenvs = True
EXTRAS = "dev,report,video,window,minari,lerobot,web"


@nox.session(python=["3.11", "3.12", "3.13"])
def tests(session: nox.Session) -> None:
    """Install the pinned versions and run the tests; arguments go to pytest."""
    session.run_install("python", "tools/install.py", EXTRAS)
    session.run("python", "-m", "pytest", *(session.posargs or ["-q", "-rs", "-n", "auto"]))
