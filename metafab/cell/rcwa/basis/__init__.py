"""Truncated bases of the unit cell: period, sizes and number of cosines in, matrices of the pillar's indicator out.

- ``coordinates``  coordinate map of one axis, with its cosine integrals in closed form
- ``axis``         basis functions of one axis: wave numbers, overlaps with the pillar, parity
- ``transverse``   coefficients of the transverse field of one symmetry class, as TM and TE waves
- ``tangent``      derivative of one axis by the size of its outline
"""
