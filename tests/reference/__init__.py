"""Slow, plain models written from the specifications alone; they judge the product and share nothing with it."""
