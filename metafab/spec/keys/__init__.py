"""Keys of the input files.

- ``reference`` every key of a spec with its type, unit, default, range and meaning; suggestions for misspelt names
- ``search``    all keys by kind of file, and search by a part of a name
- ``faults``    errors of the validation library -> faults in our words
"""
