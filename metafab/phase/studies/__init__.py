"""Studies of target phases at the level of the paraxial pupil, before any pillar is chosen.

- ``compare``      Cramer-Rao bounds of depth for several masks at equal aperture and light
- ``bandwidth``    loss of depth information behind a colour filter, and remedies
- ``propose``      choice of [L, epsilon] of spiral zones for a range of depths and its noise
- ``study``        lobe, bounds and filter of one design
- ``study_store``  ``phase_study.h5``
"""
