# Sixteen real two-photon prints with their designs: convert, align, predict, score, export an STL for every field.
#   make real RECORDINGS=/folder/that/holds/two_photon

REAL := $(RUNS)/real
REAL_SOURCE := $(RECORDINGS)/two_photon
REAL_FIELDS := $(patsubst $(REAL_SOURCE)/%_design_levels.tif,%,$(wildcard $(REAL_SOURCE)/*_design_levels.tif))
REAL_PARAMETERS ?= configs/paper-defaults.yaml

.PHONY: real
real: $(foreach field,$(REAL_FIELDS),$(REAL)/$(field)/score.json $(REAL)/$(field)/target.stl) | $(VENV)/.installed ## Align, predict, score real prints (RECORDINGS=...)
	@test -n "$(REAL_FIELDS)" || { echo "error: no *_design_levels.tif in $(REAL_SOURCE); see README.md, Real prints"; exit 1; }
	$(BIN)/python -m tests.bench.real $(REAL)

$(REAL)/%/target.tif: $(REAL_SOURCE)/%_design_levels.tif | $(VENV)/.installed
	@mkdir -p $(@D)
	$(DLW) convert $< $@ --pitch-um 0.1 --z-scale 0.1 --overwrite

$(REAL)/%/recording.tif: $(REAL_SOURCE)/%_afm.tif | $(VENV)/.installed
	@mkdir -p $(@D)
	$(DLW) convert $< $@ --pitch-um 0.1 --overwrite

$(REAL)/%/recording.tif: $(REAL_SOURCE)/%_afm.txt | $(VENV)/.installed
	@mkdir -p $(@D)
	$(DLW) convert $< $@ --pitch-um 0.1 --z-scale 1e6 --overwrite

$(REAL)/%/aligned.tif: $(REAL)/%/recording.tif $(REAL)/%/target.tif
	$(DLW) align $^ -o $@ --report $(@D)/align.yaml --overwrite

$(REAL)/%/predicted.tif: $(REAL)/%/target.tif $(REAL_PARAMETERS)
	$(DLW) predict $< -p $(REAL_PARAMETERS) -o $@ --overwrite

$(REAL)/%/score.json: $(REAL)/%/predicted.tif $(REAL)/%/aligned.tif
	$(DLW) score $^ --json $@ --plot $(@D)/score.png --overwrite --quiet

$(REAL)/%/target.stl: $(REAL)/%/target.tif
	$(DLW) export-stl $< -o $@ --overwrite

.PRECIOUS: $(REAL)/%/target.tif $(REAL)/%/recording.tif $(REAL)/%/aligned.tif $(REAL)/%/predicted.tif
