"""What can be known about depth: Fisher information and Cramer-Rao bounds."""
