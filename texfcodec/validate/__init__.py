"""All errors and oddities of a stream in one pass (validate.py); the decoder stops at the first error."""
