"""The register maps of the NOVA chips as data."""
