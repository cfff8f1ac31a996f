"""Maxwell's equations of one layer as matrices, for each cross-section."""
