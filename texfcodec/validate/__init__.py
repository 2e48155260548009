"""Everything that is wrong or odd in a stream, in one go (validate.py); the decoder stops at the first error."""
