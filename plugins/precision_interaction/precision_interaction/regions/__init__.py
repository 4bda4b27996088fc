"""The brain: three spiking regions, and the knowledge of the gap."""
