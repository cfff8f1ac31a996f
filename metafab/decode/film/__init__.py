"""Films: change detection, tracking of segments, frame after frame."""
