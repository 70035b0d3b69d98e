"""Stories of concealed physics, told from one run of commands each."""

from tests.stories import absorbed, artefact, corrected, reprint, wrong

STORIES = {"absorbed": absorbed, "wrong": wrong, "reprint": reprint, "corrected": corrected, "artefact": artefact}
