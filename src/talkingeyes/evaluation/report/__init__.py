"""The report of the chain: what a model must reach, what models are chosen by, plots."""
