"""Scattering of one incident wave by layers: matrices P, Q and half spaces in, transmitted and reflected field out.

- ``half_space``  outgoing plane waves, isotropic and birefringent
- ``modes``       one layer by its modes, stable at any height, and their conditioning
- ``faces``       amplitudes that leave one layer on both sides
- ``doubling``    one layer without modes, by doubling its thickness: the fast way, with a test of its rounding
- ``reverse``     derivatives of F by P and Q: the doubling in reverse
- ``stack``       several layers, by slabs or by modes
"""
