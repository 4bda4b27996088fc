"""Configurations of devices, one file for each kind of controller; drivers and emulators are imported when built."""
