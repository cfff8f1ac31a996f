"""Raw frames in memory and in files.

- ``frame``    RawFrame and Truth, raw.h5
- ``batch``    training data: frames of many seeds and scenes in one file
- ``foreign``  TIFF, PNG and NumPy files of real cameras
- ``defects``  their dead pixels, and a black level that is too high
"""
