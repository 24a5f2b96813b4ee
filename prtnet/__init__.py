"""The ground floor of prtnet: mathematics, data types, file formats and the command line."""

__version__ = "0.1.0"
