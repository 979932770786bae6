"""The TMC5160 clock by clock, written from its data sheet: what the compiled chip is compared with."""
