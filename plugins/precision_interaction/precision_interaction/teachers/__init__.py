"""The teachers: analytic regions with the ports of the spiking ones; one line of a file swaps one for the other."""
