"""What a candidate costs and how it looks, in as many ways as there are kinds of candidates. All enter by rd.py."""
