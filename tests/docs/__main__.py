"""`make manual`: pages of commands, faults and pictures, and the figure of the architecture, made anew."""

from __future__ import annotations

from tests.docs import api_page, architecture_figure, command_pages, desk_pictures, fault_page, picture_page

command_pages.main()
architecture_figure.main()
fault_page.main()
desk_pictures.main()
picture_page.main()
api_page.main()
