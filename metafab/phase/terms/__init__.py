"""Terms of a target phase: each is a function of position and polarisation, in radians.

- ``profile``   Term (the protocol), PolarisedTerm (base of the terms here), PhaseProfile (their sum)
- ``carriers``  lens, split lens (Eqs. 3 and 4 of Shen 2023), grating, axicon
- ``helices``   spiral zones (Eq. 2), their optimised form as a sum of waves, vortex, double helix
- ``zernike``   Zernike polynomials
- ``sampled``   phases given by samples, for instance a user's file
- ``hologram``  Gerchberg-Saxton design of a phase that projects a picture
- ``angles``    compiled arctangents of complex numbers, and of sums of waves
"""
