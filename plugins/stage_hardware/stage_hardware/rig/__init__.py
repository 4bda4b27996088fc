"""Rigs: stages of several controllers and a force sensor that together make one machine."""
