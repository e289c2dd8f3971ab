"""`python -m bssrdf`."""

from bssrdf.cli import main

main()
