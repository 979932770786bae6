"""Chips of Trinamic for PulseStage, a subpackage each; `stage chips` lists them once this package is installed."""
