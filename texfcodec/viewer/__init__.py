"""A page that shows decoded assets with WebGL2: its data, its server, its export to one file, and a browser without a window."""
