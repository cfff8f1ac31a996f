"""Raw frames in memory and in files.

- ``frame``    RawFrame and Truth
- ``store``    raw.h5
- ``foreign``  TIFF, PNG and NumPy files of real cameras
"""
