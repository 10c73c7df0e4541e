"""One connected fish: connecting, what it stores, diagnostics, flashing."""
