"""Optimisers of a helix, and bounds on the result of any optimiser.

- ``rotation``    the law of rotation, and the main lobe measured in PSFs
- ``peak``        the brightest main lobe over the whole turn (the IFTA step of Shen 2023), and upper bounds of
                  its brightness for any mask
- ``side_lobes``  the brightest helix whose side lobes stay below a limit
- ``blind``       the helix with the largest depth information for unknown texture
"""
