"""`python -m magical`: the same as the `magical` command."""

import sys

from magical.cli import main

sys.exit(main())
