"""Commissioning: what a person does with a rig, step by step, before a brain may move it."""
