"""Speed and memory of the kernels and of replicates, each beside a yardstick."""
