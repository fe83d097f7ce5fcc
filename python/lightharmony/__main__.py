"""`python -m lightharmony`: the program itself."""

import sys

from .program import main

sys.exit(main())
