"""Firmware of STEP/DIR axes. Each axis has a step timer, which makes the steps in compiled code."""
