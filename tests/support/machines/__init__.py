"""The state machines of Hypothesis: hosts, chips and stages that do what they like, and what must hold."""
