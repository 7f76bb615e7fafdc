"""`make manual`: pages of commands, faults and pictures, and the figure of the architecture, made anew."""

from __future__ import annotations

from tests.docs import (
    api_page,
    architecture_figure,
    certificate_picture,
    command_pages,
    desk_pictures,
    evidence_page,
    fault_page,
    first_pictures,
    gallery_page,
    monitor_picture,
    picture_page,
    study_pages,
)

command_pages.main()
architecture_figure.main()
fault_page.main()
desk_pictures.main()
first_pictures.main()
certificate_picture.main()
monitor_picture.main()
picture_page.main()
api_page.main()
gallery_page.main()
evidence_page.main()
study_pages.main()
