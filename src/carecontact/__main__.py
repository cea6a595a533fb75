"""``python -m carecontact``, for where the ``carecontact`` script is not on the path."""

import sys

from carecontact.cli import main

sys.exit(main())
