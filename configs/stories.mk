# Told stories of concealed physics on the virtual press: every step a command, every number from the run, claims judged.
#   make stories [STORIES="absorbed wrong"]
# runs/stories/NAME/README.md is a story's page; each begins anew. The exit code is 1 where a claim does not hold.

STORIES ?=

.PHONY: stories
stories: $(VENV)/.installed ## Tell stories of concealed physics on the virtual press (pages in runs/stories; STORIES="absorbed wrong")
	$(BIN)/python -m tests.stories $(RUNS)/stories $(STORIES)
