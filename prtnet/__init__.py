"""The ground floor of prtnet: mathematics, data types, file formats and the command line."""

import os

__version__ = "0.1.0"

# Else MKL, which torch multiplies matrices with, may add in another order where they happen to lie
# otherwise in memory: on AMD's processors a block of clusters then differs from all of them at once
# by rounding. It looks when it first computes. Costs nothing that could be measured.
os.environ.setdefault("MKL_CBWR", "AUTO")
