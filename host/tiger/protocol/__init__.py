"""The wire: generated messages, framing, links and clock synchronisation."""
