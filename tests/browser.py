"""A Chromium on this machine, for tests that need one."""

import os
import shutil

import pytest

NAMES = (os.environ.get("CHROMIUM", "chromium"), "chromium", "chromium-browser", "google-chrome")
BROWSER = next(filter(None, map(shutil.which, NAMES)), None)
FLAGS = ["--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--no-first-run",
         "--disable-background-networking", "--disable-dev-shm-usage"]
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on PATH to open the page in")
