"""Keys of the input files.

- ``reference`` every key of a spec with its type, unit, default, range and meaning; suggestions for misspelt names
- ``faults``    errors of the validation library -> faults in our words
"""
