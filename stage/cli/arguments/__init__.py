"""What each command takes. Cheap: nothing heavy is imported before a command runs."""
