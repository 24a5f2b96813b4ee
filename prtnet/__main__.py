"""``python -m prtnet``."""

from prtnet.cli import main

main()
