# Sixteen real two-photon prints with their designs: convert, align, calibrate on four, predict the other twelve, score,
# export an STL for every field.
#   make real RECORDINGS=/folder/that/holds/two_photon
#
# The four are every fourth of the sorted list from the first on: chosen by their place, whatever they show.

REAL := $(RUNS)/real
REAL_SOURCE := $(RECORDINGS)/two_photon
REAL_FIELDS := $(sort $(patsubst $(REAL_SOURCE)/%_design_levels.tif,%,$(wildcard $(REAL_SOURCE)/*_design_levels.tif)))
REAL_FOUR := $(foreach place,1 5 9 13,$(word $(place),$(REAL_FIELDS)))
REAL_OTHERS := $(filter-out $(REAL_FOUR),$(REAL_FIELDS))
REAL_START ?= configs/real.yaml
REAL_INSTRUMENT := --instrument afm --fast-axis-deg 0
# the files do not say it; noise of their rows shows it

.PHONY: real
real: $(foreach field,$(REAL_FIELDS),$(REAL)/$(field)/aligned.tif $(REAL)/$(field)/target.stl) $(foreach field,$(REAL_OTHERS),$(REAL)/$(field)/default.tif $(REAL)/$(field)/score.json) | $(VENV)/.installed ## Align, calibrate, predict, score real prints (RECORDINGS=...)
	@test -n "$(REAL_FIELDS)" || { echo "error: no *_design_levels.tif in $(REAL_SOURCE); see docs/real-prints.md"; exit 1; }
	@$(BIN)/python -m tests.bench.real $(REAL) $(REAL_FOUR)

$(REAL)/%/target.tif: $(REAL_SOURCE)/%_design_levels.tif | $(VENV)/.installed
	@mkdir -p $(@D)
	$(DLW) convert $< $@ --pitch-um 0.1 --z-scale 0.1 --overwrite

$(REAL)/%/recording.tif: $(REAL_SOURCE)/%_afm.tif | $(VENV)/.installed
	@mkdir -p $(@D)
	$(DLW) convert $< $@ --pitch-um 0.1 $(REAL_INSTRUMENT) --overwrite

$(REAL)/%/recording.tif: $(REAL_SOURCE)/%_afm.txt | $(VENV)/.installed
	@mkdir -p $(@D)
	$(DLW) convert $< $@ --pitch-um 0.1 --z-scale 1e6 $(REAL_INSTRUMENT) --overwrite

$(REAL)/%/aligned.tif: $(REAL)/%/recording.tif $(REAL)/%/target.tif
	$(DLW) align $^ -o $@ --report $(@D)/align.yaml --overwrite

$(REAL)/process.yaml: $(REAL_START) $(foreach field,$(REAL_FOUR),$(REAL)/$(field)/target.tif $(REAL)/$(field)/aligned.tif)
	$(DLW) calibrate $(foreach field,$(REAL_FOUR),--pair $(REAL)/$(field)/target.tif $(REAL)/$(field)/aligned.tif) \
	  -p $< -o $@ --report $(REAL)/calibration.yaml --overwrite

$(REAL)/%/default.tif: $(REAL)/%/target.tif $(REAL_START)
	$(DLW) predict $< -p $(REAL_START) -o $@ --overwrite

$(REAL)/%/predicted.tif: $(REAL)/%/target.tif $(REAL)/process.yaml
	$(DLW) predict $< -p $(REAL)/process.yaml -o $@ --overwrite

$(REAL)/%/score.json: $(REAL)/%/predicted.tif $(REAL)/%/aligned.tif
	$(DLW) score $^ --json $@ --plot $(@D)/score.png --overwrite --quiet

$(REAL)/%/target.stl: $(REAL)/%/target.tif
	$(DLW) export-stl $< -o $@ --overwrite

# What is missing in the model of these prints: every other field of the list, the rest held out.
REAL_PAIR = $(REAL)/$(1)/target.tif $(REAL)/$(1)/aligned.tif
REAL_EIGHT := $(foreach place,1 3 5 7 9 11 13 15,$(word $(place),$(REAL_FIELDS)))
REAL_HELD_OUT := $(filter-out $(REAL_EIGHT),$(REAL_FIELDS))

.PHONY: real-diagnosis
real-diagnosis: $(REAL)/diagnosis.yaml ## Diagnose eight real prints, the other eight held out (RECORDINGS=...)

$(REAL)/diagnosis.yaml: $(REAL_START) $(foreach field,$(REAL_FIELDS),$(call REAL_PAIR,$(field)))
	$(DLW) diagnose $(foreach field,$(REAL_EIGHT),--pair $(call REAL_PAIR,$(field))) \
	  $(foreach field,$(REAL_HELD_OUT),--holdout $(call REAL_PAIR,$(field))) -p $< -o $@ --params-out $(REAL)/extended.yaml \
	  --maps $(REAL)/maps --report $(REAL)/diagnosis.html --overwrite --verbose

# An answer that was ended early is one all the same, and is kept; removed, it is begun anew.
.PRECIOUS: $(REAL)/diagnosis.yaml $(REAL)/%/target.tif $(REAL)/%/recording.tif $(REAL)/%/aligned.tif $(REAL)/%/default.tif $(REAL)/%/predicted.tif

.PHONY: real-folds
real-folds: $(foreach field,$(REAL_FIELDS),$(REAL)/$(field)/aligned.tif) | $(VENV)/.installed ## Diagnose the real prints halved at random, seven times (two hours; goes on; result in docs/evidence)
	$(BIN)/python -m tests.bench.folds $(REAL) $(FOLDS)
