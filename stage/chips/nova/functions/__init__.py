"""What NOVA chips do beside driving, compiled: home search, comparators, synchronous actions, timer, inputs and outputs."""
