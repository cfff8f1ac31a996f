"""Pages, pictures and films of single results.

- ``benchmark``  page of benchmark rows
- ``pictures``   a library, proposals, a comparison of cameras, a decoded full-Stokes frame
- ``film``       a decoded film
"""
