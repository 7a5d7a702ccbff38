"""``python -m mapmend``."""

import sys

from mapmend.cli import main

sys.exit(main())
