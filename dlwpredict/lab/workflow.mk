# From raw recordings to corrected parts, for a lab: `dlwpredict init FOLDER` lays out a folder with this file as its
# Makefile; there type `make`, or `make help`.
#
#   targets/PART.*              what the print was to be: any height map that `dlwpredict convert` reads
#   recordings/PART.*           its raw recording; PART--NOTE.* for a second print or a second recording of it
#   written/PART--NOTE.tif      what was sent to the printer for that print, where it was not the target itself
#                               (a corrected map of an earlier round: copy results/PART/corrected.tif here when you print it)
#   settings.mk                 the settings below, where they differ; it names start.yaml, where the fit begins
#
#   results/process.yaml        the process, learned from all recordings together; calibration.yaml its figures and warnings
#   results/found.yaml          the same with what was missing in the model, from one diagnosis of all recordings:
#                               diagnosis.yaml, diagnosis.html; every correction is made with it (DIAGNOSE = no: without)
#   results/PART[--NOTE]/       recording.tif, aligned.tif and align.yaml, predicted.tif, score.json and score.png
#                               (the prediction against the recording)
#   results/PART/               target.tif, corrected.tif and corrected.stl, of every target, recorded or not
#   results/report.html         all of it on one page
#
# `make` redoes what depends on a changed file or setting and nothing else; `make -j2` does two things at a time; `make -n` says what
# would be done. Names hold no spaces, and their first dot starts the ending.

-include settings.mk

DLW ?= dlwpredict
# The parameters to start from, and their bounds; empty: the paper's seven, heights not cut into slices.
START ?=
# Options for one step. A name after the step is for one file: CONVERT_lens--monday = --pitch-um 100nm
CONVERT_TARGET ?=
CONVERT ?=
# --distortion rigid where the microscope's lateral scale can be trusted: a part that shrank must not be stretched to fit.
ALIGN ?=
CALIBRATE ?=
# Options of the diagnosis, or no: correct by the seven parameters alone.
DIAGNOSE ?=
# --undecided print or measurement, where the diagnosis cannot tell the side of what it finds.
CORRECT ?=
EXPORT ?=
# Recordings that are scored but do not teach the process.
HOLD_OUT ?=

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := all
.DELETE_ON_ERROR:
export OPENBLAS_NUM_THREADS ?= 1

spaced := $(shell find targets recordings written -name '* *' 2>/dev/null)
$(if $(spaced),$(error names must not hold spaces: $(spaced)))

# Height maps of a folder; the name of a file; the file of a name in a folder; the part of a name.
maps = $(filter-out %.provenance.yaml %.md,$(wildcard $(1)/*.*))
name = $(firstword $(subst ., ,$(notdir $(1))))
found = $(filter $(1)/$(2).%,$(call maps,$(1)))
part = $(firstword $(subst --, ,$(1)))

PARTS := $(sort $(foreach f,$(call maps,targets),$(call name,$(f))))
NAMES := $(sort $(foreach f,$(call maps,recordings),$(call name,$(f))))
LEARNT := $(filter-out $(HOLD_OUT),$(NAMES))

ifneq ($(MAKECMDGOALS),help)
$(if $(PARTS),,$(error targets: no height map there; see the head of this file))
$(if $(LEARNT),,$(error recordings: none to learn from; see the head of this file))
$(foreach n,$(PARTS),$(if $(word 2,$(call found,targets,$(n))),$(error targets: $(n) stands there twice)))
$(foreach n,$(NAMES),$(if $(word 2,$(call found,recordings,$(n))),$(error recordings: $(n) stands there twice)))
$(foreach n,$(NAMES),$(if $(filter $(call part,$(n)),$(PARTS)),,$(error recordings: $(n) has no target $(call part,$(n)) in targets)))
endif

# The options of a step stand in a file that changes only when they do: $(call noted,STEP-NAME,OPTIONS) is that file.
quoted = '$(subst ','\'',$(strip $(1)))'
note = mkdir -p $(dir $(1)) && { printf '%s\n' $(call quoted,$(2)) | cmp -s - $(1) || printf '%s\n' $(call quoted,$(2)) > $(1); }
noted = $(shell $(call note,results/.options/$(1),$(2)))results/.options/$(1)

# What a recording shows: the map that was written, or the target.
design = results/$(if $(call found,written,$(1)),$(1)/written,$(call part,$(1))/target).tif

# What every target is corrected by.
PROCESS = results/$(if $(filter no,$(DIAGNOSE)),process,found).yaml

.PHONY: all align calibrate diagnose correct clean help
all: align calibrate correct results/report.html ## Everything: results/report.html shows it
align: $(foreach n,$(NAMES),results/$(n)/aligned.tif) ## Lay every recording on its target
calibrate: results/process.yaml $(foreach n,$(NAMES),results/$(n)/score.json) ## Learn the process, and score it
diagnose: results/found.yaml ## Find what the model lacks
correct: $(foreach p,$(PARTS),results/$(p)/corrected.stl) ## Correct every target, as STL
clean: ## Remove all results
	rm -rf results
help: ## List the targets, and the settings of settings.mk
	@grep -hE '^[a-z]+:.*## ' $(firstword $(MAKEFILE_LIST)) | awk -F ':.*## ' '{printf "  make %-10s %s\n", $$1, $$2}'
	@echo "  settings: START CONVERT_TARGET CONVERT ALIGN CALIBRATE DIAGNOSE CORRECT EXPORT HOLD_OUT"

# $(1) = PART
define rules_of_part
results/$(1)/target.tif: $(call found,targets,$(1)) $(call noted,target-$(1),$(CONVERT_TARGET) $(CONVERT_TARGET_$(1)))
	@mkdir -p $$(@D)
	$$(DLW) convert $$< $$@ $$(CONVERT_TARGET) $$(CONVERT_TARGET_$(1)) --overwrite

results/$(1)/corrected.tif: results/$(1)/target.tif $(PROCESS) $(call noted,correct-$(1),$(PROCESS) $(CORRECT) $(CORRECT_$(1)))
	$$(DLW) precompensate $$< -p $(PROCESS) -o $$@ --report $$(@D)/precompensation.yaml \
	  --unreachable $$(@D)/unreachable.tif \
	  $$(CORRECT) $$(CORRECT_$(1)) --overwrite

results/$(1)/corrected.stl: results/$(1)/corrected.tif $(call noted,export-$(1),$(EXPORT) $(EXPORT_$(1)))
	$$(DLW) export-stl $$< -o $$@ $$(EXPORT) $$(EXPORT_$(1)) --overwrite
endef
$(foreach p,$(PARTS),$(eval $(call rules_of_part,$(p))))

# $(1) = PART or PART--NOTE; it is aligned to the target, and compared with the prediction of what was written
define rules_of_recording
results/$(1)/recording.tif: $(call found,recordings,$(1)) $(call noted,recording-$(1),$(CONVERT) $(CONVERT_$(1)))
	@mkdir -p $$(@D)
	$$(DLW) convert $$< $$@ $$(CONVERT) $$(CONVERT_$(1)) --overwrite

results/$(1)/aligned.tif: results/$(1)/recording.tif results/$(call part,$(1))/target.tif \
  $(call noted,align-$(1),$(ALIGN) $(ALIGN_$(1)))
	$$(DLW) align $$(filter %.tif,$$^) -o $$@ --report $$(@D)/align.yaml $$(ALIGN) $$(ALIGN_$(1)) --overwrite

results/$(1)/predicted.tif: $(call design,$(1)) results/process.yaml
	$$(DLW) predict $$< -p results/process.yaml -o $$@ --overwrite

results/$(1)/score.json: results/$(1)/predicted.tif results/$(1)/aligned.tif
	$$(DLW) score $$^ --part-only --json $$@ --plot $$(@D)/score.png --overwrite --quiet
endef
$(foreach n,$(NAMES),$(eval $(call rules_of_recording,$(n))))

# $(1) = PART--NOTE
define rule_of_written
results/$(1)/written.tif: $(call found,written,$(1))
	@mkdir -p $$(@D)
	$$(DLW) convert $$< $$@ --overwrite
endef
$(foreach n,$(NAMES),$(if $(call found,written,$(n)),$(eval $(call rule_of_written,$(n)))))

PAIRS := $(foreach n,$(LEARNT),--pair $(call design,$(n)) results/$(n)/aligned.tif)
results/process.yaml: $(START) $(filter-out --pair,$(PAIRS)) $(call noted,calibrate,$(PAIRS) $(START) $(CALIBRATE))
	$(DLW) calibrate $(PAIRS) \
	  $(if $(START),-p $(START)) -o $@ --report results/calibration.yaml $(CALIBRATE) --overwrite

results/found.yaml: $(START) $(filter-out --pair,$(PAIRS)) $(call noted,diagnose,$(PAIRS) $(START) $(DIAGNOSE))
	$(DLW) diagnose $(PAIRS) \
	  $(if $(START),-p $(START)) -o results/diagnosis.yaml --params-out $@ --report results/diagnosis.html \
	  $(DIAGNOSE) --overwrite

results/report.html: $(foreach n,$(NAMES),results/$(n)/score.json) $(foreach p,$(PARTS),results/$(p)/corrected.stl)
	$(DLW) report results -o $@ --overwrite
