"""Bus programs that several tests run."""

NUMBERS = {f"R{n}": n for n in range(8)}


def load_registers(chip, **values):
    """Write registers by name, high byte first."""
    for name, value in values.items():
        chip.write(0, 0x80 | NUMBERS[name])
        for address in (3, 2, 1):
            chip.write(address, value >> 8 * (address - 1) & 0xFF)


def start_preset(chip, pulses, minus=False):
    """A high-speed preset move at a rate that every default axis follows: 500 to 10,000 pps in 0.15 s."""
    load_registers(chip, R0=pulses, R1=25, R2=500, R3=500, R4=1500, R5=1500, R6=800, R7=30)
    chip.write(0, 0x08)
    chip.write(0, 0x4C if minus else 0x44)
    chip.write(0, 0x15)
