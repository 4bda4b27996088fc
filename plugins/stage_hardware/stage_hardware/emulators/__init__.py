"""Emulators of controllers and sensors: they answer on the wire, move, and fail, as the devices would."""
