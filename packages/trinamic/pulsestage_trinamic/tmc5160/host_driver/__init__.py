"""Host driver of the TMC5160: the software that a host runs to move and home an axis with this chip."""
