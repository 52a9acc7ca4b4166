"""What a person uses: the command line, the recording, the summary."""
