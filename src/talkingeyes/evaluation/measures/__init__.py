"""What is measured in a motion, by subject: the metrics of the benchmark and the statistics of the reference ranges."""
