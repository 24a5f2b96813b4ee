"""Structure-aware fuzzing: small valid files of every format that prtnet reads, and damage to them.

``bench/fuzz.py`` tries a hundred thousand of each, the tests a few hundred.
"""
