"""What every layer uses: errors, files, records, references, trial files, law, native library."""
