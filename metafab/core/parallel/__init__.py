"""Parallel work.

- ``work``        Work: workers, cluster and progress of a long computation
- ``executor``    executors over processes, threads or a Dask cluster, and streams of results
- ``cluster``     executor over a Dask cluster, watch over its scheduler and workers
- ``forked``      short work in forked processes
- ``beside``      one call in a forked process, while this one goes on
- ``processes``   worker processes, which end with their parent
- ``interrupts``  Ctrl-C and SIGTERM
- ``progress``    the progress callback
- ``measure``     time and memory of a block
- ``memory``      freed memory, kept or given back
"""
