"""`make manual`: the pages of the commands and the figure of the architecture, written anew."""

from __future__ import annotations

from tests.docs import api_page, architecture_figure, command_pages, fault_page

command_pages.main()
architecture_figure.main()
fault_page.main()
api_page.main()
