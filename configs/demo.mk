# The whole loop on sample_data/: convert, align, calibrate, predict, score; diagnose what the seven parameters leave;
# correct with what was found, export an STL, and a page of it all. At the end the virtual press that printed the samples
# prints the corrected parts, and beside them those that the seven parameters alone would have corrected, as the proof.

DEMO := $(RUNS)/demo
SEVEN := $(RUNS)/demo-seven
DEMO_PARTS := cin air

DEMO_RESULTS := $(foreach part,$(DEMO_PARTS),$(DEMO)/$(part)/score.json $(DEMO)/$(part)/corrected.stl \
  $(DEMO)/$(part)/reprinted.tif $(SEVEN)/$(part)/reprinted.tif) $(DEMO)/report.html

.PHONY: sample-data
sample-data: | $(VENV)/.installed ## Make sample_data/ anew from the virtual press
	$(BIN)/python -m sample_data.make
	@ls -l sample_data

$(DEMO)/%/target.tif: sample_data/%_target.tif | $(VENV)/.installed
	@mkdir -p $(@D)
	$(DLW) convert $< $@ --overwrite

$(DEMO)/cin/recording.tif: sample_data/cin_recording.txt.gz | $(VENV)/.installed
	@mkdir -p $(@D)
	$(DLW) convert $< $@ --pitch-um 0.3125 --z-scale 1e6 --overwrite

$(DEMO)/air/recording.tif: sample_data/air_recording.tif | $(VENV)/.installed
	@mkdir -p $(@D)
	$(DLW) convert $< $@ --pitch-um 0.3125 --overwrite

$(DEMO)/%/aligned.tif: $(DEMO)/%/recording.tif $(DEMO)/%/target.tif
	$(DLW) align $^ -o $@ --report $(@D)/align.yaml --overwrite

DEMO_PAIRS := $(foreach part,$(DEMO_PARTS),$(DEMO)/$(part)/target.tif $(DEMO)/$(part)/aligned.tif)
$(DEMO)/process.yaml: configs/paper-defaults.yaml $(DEMO_PAIRS)
	$(DLW) calibrate $(foreach part,$(DEMO_PARTS),--pair $(DEMO)/$(part)/target.tif $(DEMO)/$(part)/aligned.tif) \
	  -p $< -o $@ --report $(DEMO)/calibration.yaml --overwrite

$(DEMO)/%/predicted.tif: $(DEMO)/%/target.tif $(DEMO)/process.yaml
	$(DLW) predict $< -p $(DEMO)/process.yaml -o $@ --overwrite

$(DEMO)/%/score.json: $(DEMO)/%/predicted.tif $(DEMO)/%/aligned.tif
	$(DLW) score $^ --part-only --json $@ --plot $(@D)/score.png --overwrite

# Where a finding could be either, the print is corrected for it: here the recordings have no other use.
$(DEMO)/found.yaml $(DEMO)/diagnosis.yaml &: configs/paper-defaults.yaml $(DEMO_PAIRS)
	$(DLW) diagnose $(foreach part,$(DEMO_PARTS),--pair $(DEMO)/$(part)/target.tif $(DEMO)/$(part)/aligned.tif) \
	  -p $< -o $(DEMO)/diagnosis.yaml --params-out $(DEMO)/found.yaml --report $(DEMO)/diagnosis.html --no-advice --overwrite

$(DEMO)/%/corrected.tif: $(DEMO)/%/target.tif $(DEMO)/found.yaml
	$(DLW) precompensate $< -p $(DEMO)/found.yaml -o $@ --report $(@D)/precompensation.yaml \
	  --unreachable $(@D)/unreachable.tif --undecided print --overwrite

$(SEVEN)/%/corrected.tif: $(DEMO)/%/target.tif $(DEMO)/process.yaml
	@mkdir -p $(@D)
	$(DLW) precompensate $< -p $(DEMO)/process.yaml -o $@ --overwrite --quiet

$(DEMO)/%/corrected.stl: $(DEMO)/%/corrected.tif
	$(DLW) export-stl $< -o $@ --overwrite

$(DEMO)/%/reprinted.tif: $(DEMO)/%/corrected.tif configs/press.yaml
	$(BIN)/python -m tests.press print $< -p configs/press.yaml -o $@ --overwrite

$(SEVEN)/%/reprinted.tif: $(SEVEN)/%/corrected.tif configs/press.yaml
	$(BIN)/python -m tests.press print $< -p configs/press.yaml -o $@ --overwrite

$(DEMO)/report.html: $(DEMO)/diagnosis.yaml $(foreach part,$(DEMO_PARTS),$(DEMO)/$(part)/score.json $(DEMO)/$(part)/corrected.stl)
	$(DLW) report $(DEMO) -o $@ --overwrite

.PRECIOUS: $(SEVEN)/%/corrected.tif $(DEMO)/%/target.tif $(DEMO)/%/recording.tif $(DEMO)/%/aligned.tif $(DEMO)/%/predicted.tif $(DEMO)/%/corrected.tif
