"""A live stage in a browser: `Session`, a stage in real time that takes orders; `Panel`, the server of its page."""
