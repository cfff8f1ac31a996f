"""Models of the amplitudes over the sizes, fitted to solved samples, and the error that they support."""
