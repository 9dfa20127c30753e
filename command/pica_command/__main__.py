"""`python -m pica_command` is `pica`."""

import sys

from pica_command.main import main

sys.exit(main())
