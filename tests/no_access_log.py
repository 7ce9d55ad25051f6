"""Imported for its effect: services in this process log no requests.

Their threads would write to what is captured of whichever test runs, which may be closed when they do.
"""

from __future__ import annotations

import logging

import structlog

structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
