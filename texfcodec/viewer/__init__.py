"""A page that shows decoded assets with three.js: its modules (app/, bundled into web/), its server, its export to one file."""
