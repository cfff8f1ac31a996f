"""Work spread over threads, processes or a cluster, with progress, interrupts and its cost."""
