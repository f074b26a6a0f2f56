// pocket-ptam sim: the emulated phone, in one run or in the many of the laboratory.

#include <cmath>
#include <memory>
#include <optional>

#include "platform/app/commands.h"
#include "platform/app/options.h"
#include "platform/app/single_run.h"
#include "platform/camera/dump_sequence.h"
#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/text.h"
#include "sim_phone/desktop_stories.h"
#include "sim_phone/laboratory/camera_study.h"
#include "sim_phone/laboratory/culling_study.h"
#include "sim_phone/laboratory/desktop_study.h"
#include "sim_phone/laboratory/doubt_study.h"
#include "sim_phone/laboratory/endurance.h"
#include "sim_phone/laboratory/harsh_study.h"
#include "sim_phone/laboratory/judgement.h"
#include "sim_phone/laboratory/model_study.h"
#include "sim_phone/laboratory/reach_study.h"
#include "sim_phone/laboratory/start_study.h"
#include "sim_phone/laboratory/stretch_study.h"
#include "sim_phone/laboratory/suite.h"
#include "sim_phone/model_stories.h"
#include "sim_phone/motion.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/story.h"

namespace pptam::app {
namespace {

using namespace platform;

// What was asked for.
struct SimChoice {
  std::vector<std::string> stories, scenes;
  sim::PhoneOptions phone;
  std::optional<double> duration_s, exposure_s, drop_probability, frames_per_s;  // without them a story's own hold
  std::string readout;
  bool no_noise = false;
  std::vector<std::string> harsh;
  std::string dump;
  std::optional<laboratory::Phone> profile;
};

// What was asked of the laboratory.
struct ChosenStudies {
  bool suite = false;
  std::string study;
  std::vector<std::string> kinds = laboratory::study_kinds();
  int seeds = 5;
  int jobs = 1;
  bool many = false;  // seeds or jobs were given
  std::string shard;
  bool compare = false;
  std::optional<int> endurance_minutes;
  bool twice = false;
};

std::string one_of(const std::vector<std::string>& names) {
  return "One of " + joined(names);
}

CLI::Option* add_repeatable(CLI::App* command, const std::string& name, std::vector<std::string>* values,
                            const std::string& says) {
  return command->add_option(name, *values, says)
      ->type_name("NAME")
      ->expected(1)
      ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll);
}

CLI::Option* add_sequence_options(CLI::App* sim, SimChoice* chosen) {
  sim::PhoneOptions& phone = chosen->phone;
  CLI::Option* story = add_repeatable(sim, "--story", &chosen->stories,
                                      "One of the stories below; may be repeated with --suite, those of a "
                                      "known object with --study model, of the desktop system with --study desktop");
  add_repeatable(
      sim, "--scene", &chosen->scenes,
      one_of(sim::scene_names()) +
          "; may be repeated with --suite and --study culling, harsh, stretches, camera, doubts or reach [desk]");
  std::vector<std::string> motions = sim::motion_names();
  for (const std::string& name : sim::start_names()) motions.push_back(name);
  sim->add_option("--motion", phone.motion, one_of(motions))->capture_default_str()->type_name("NAME")->excludes(story);
  sim->add_option("--seed", phone.seed, "Of the scene's details, the motion and the noise")
      ->capture_default_str()
      ->type_name("N");
  sim->add_option("--scene-seed", phone.scene_seed, "Of the scene's details alone [the seed]")
      ->type_name("N")
      ->excludes(story);
  sim->add_option("--duration", chosen->duration_s, "Length of the sequence [20, or the story's]")
      ->type_name("SECONDS");
  sim->add_option("--readout", chosen->readout, "Rolling shutter, rows|columns:+|-:SECONDS [columns:-:0.060]");
  sim->add_option("--exposure", chosen->exposure_s, "Exposure time [0.03, or the story's]")->type_name("SECONDS");
  sim->add_option("--fps", chosen->frames_per_s, "Frames per second [15, or the story's]")->type_name("N");
  sim->add_flag("--no-noise", chosen->no_noise, "An ideal sensor");
  sim->add_flag("--even-readout", chosen->phone.even_readout,
                "The camera moves evenly during each image: what its change of speed within one costs");
  sim->add_option("--harsh", chosen->harsh,
                  "What makes real pictures hard: NAME or NAME:VALUE of the causes below, or all; several with commas")
      ->delimiter(',')
      ->expected(1)
      ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll)
      ->type_name("NAME[:VALUE]");
  sim->add_option("--drop", chosen->drop_probability, "Probability that the camera drops a frame [0, or the story's]")
      ->type_name("P");
  sim->add_option("--dump", chosen->dump,
                  "Only write the sequence, in TUM layout; with scene.cao and scene.pos for pocket-ptam model")
      ->type_name("DIR");
  return story;
}

void add_laboratory_options(CLI::App* sim, CLI::Option* story, ChosenStudies* chosen) {
  CLI::Option* suite = sim->add_flag("--suite", chosen->suite,
                                     "All stories, or those and the scenes named, with several seeds, as a table");
  CLI::Option* study =
      sim->add_option(
             "--study", chosen->study,
             "init: many short starts of several kinds, as a table and plots; culling: exploring runs with and without "
             "culling of keyframes, as a table; harsh: exploring runs with each cause of --harsh alone, and with all; "
             "stretches: exploring runs with two seconds of bad pictures in their midst; model: the stories of a known "
             "object, tracked in other ways, too; camera: what pocket-ptam readout finds of phones drawn by chance; "
             "doubts: whether a run says that it was told of a wrong camera; reach: how far from the views in a map a "
             "lost "
             "camera is found; desktop: the stories of the desktop system, with --profile desktop")
          ->type_name("NAME")
          ->excludes(suite);
  add_repeatable(sim, "--kind", &chosen->kinds,
                 one_of(laboratory::study_kinds()) + "; may be repeated, for --study [all]")
      ->needs(study);
  const auto mark = [chosen](const std::string&) { chosen->many = true; };
  sim->add_option("--seeds", chosen->seeds, "Seeds of each story or kind, for --suite and --study")
      ->capture_default_str()
      ->check(CLI::Range(1, 1000))
      ->each(mark)
      ->type_name("N");
  sim->add_option("--jobs", chosen->jobs, "Threads, for --suite and --study")
      ->capture_default_str()
      ->check(CLI::Range(1, 256))
      ->each(mark)
      ->type_name("N");
  sim->add_option("--shard", chosen->shard, "Only the I-th of N parts of the suite's runs")
      ->type_name("I/N")
      ->needs(suite);
  sim->add_flag("--compare", chosen->compare,
                "In the suite, exploring stories also with a global shutter, and with a rolling one that the system is "
                "not told of")
      ->needs(suite);
  CLI::Option* endurance =
      sim->add_option("--endurance", chosen->endurance_minutes,
                      "Long life: a lap of a minute through the scene, rendered once, is seen round and round for so "
                      "many minutes, with cuts and a covered lens; judged by the minute. Exit code 1 when accuracy or "
                      "cost do not hold")
          ->type_name("MINUTES")
          ->excludes(story)
          ->excludes(suite)
          ->excludes(study);
  sim->add_flag("--twice", chosen->twice, "With --endurance: a second run must give the same maps")->needs(endurance);
}

std::string footer() {
  std::string text = "Stories:\n";
  for (const sim::StoryKind& kind : sim::stories()) text += format("  %-16s %s\n", kind.name, kind.says);
  text += "Stories of the desktop system, for --profile desktop:\n";
  for (const sim::DesktopStory& story : sim::desktop_stories()) text += format("  %-16s %s\n", story.name, story.says);
  text += "Stories of a known object, for the tracker of pocket-ptam model:\n";
  for (const sim::ModelStory& story : sim::model_stories()) text += format("  %-16s %s\n", story.name, story.says);
  text += "Causes of --harsh:\n";
  for (const sim::Cause& cause : sim::causes())
    text += format("  %-16s %s [%g]\n", cause.name, cause.says, cause.usual);
  return text +
         "Examples:\n"
         "  pocket-ptam sim --scene boxes --seed 3 --out out/boxes3\n"
         "  pocket-ptam sim --story shake --seed 2\n"
         "  pocket-ptam sim --readout rows:+:0.030 --fps 30   another phone's shutter\n"
         "  pocket-ptam sim --phone pi_zero --trace desk.json  that phone's camera and times, and a trace for "
         "Perfetto\n"
         "  pocket-ptam sim --show                            as it goes, in a window or on the screen\n"
         "  pocket-ptam sim --dump /tmp/desk                  a sequence for other programs\n"
         "  pocket-ptam sim --harsh people,flicker:0.3 --exposure 0.004\n"
         "  pocket-ptam sim --save-map desk.map\n"
         "  pocket-ptam sim --load-map desk.map --lock-map --seed 2 --scene-seed 1\n"
         "  pocket-ptam sim --suite --seeds 5 --jobs 2 --compare\n"
         "  pocket-ptam sim --suite --story orbit --story zoom --seeds 20\n"
         "  pocket-ptam sim --study init --seeds 20 --jobs 2\n"
         "  pocket-ptam sim --study culling --scene desk --scene walls --seeds 50 --jobs 2\n"
         "  pocket-ptam sim --study harsh --seeds 5 --jobs 2\n"
         "  pocket-ptam sim --study stretches --seeds 6 --jobs 2\n"
         "  pocket-ptam sim --story model-machine --seed 2\n"
         "  pocket-ptam sim --study model --seeds 3 --jobs 2\n"
         "  pocket-ptam sim --study camera --seeds 10 --jobs 2\n"
         "  pocket-ptam sim --study reach --seeds 5 --jobs 2\n"
         "  pocket-ptam sim --endurance 60 --scene desk --twice";
}

// The command once its options are read.
class SimCommand {
 public:
  explicit SimCommand(const std::string& command_line) : command_line_(command_line) {}

  void add_options(CLI::App* sim) {
    CLI::Option* story = add_sequence_options(sim, &chosen_);
    add_laboratory_options(sim, story, &studies_);
    add_run_options(sim, &run_, &output_);
    add_phone_option(sim, &run_, &chosen_.profile);
    add_show_options(sim, &output_.show);
    sim->footer(footer());
  }

  int run() {
    choose_phone();
    const bool many_runs = studies_.suite || !studies_.study.empty() || studies_.endurance_minutes;
    if ((many_runs || !chosen_.dump.empty()) && (run_.save_map || run_.lock_map || !run_.load_map.empty()))
      throw InputError("--load-map, --save-map and --lock-map belong to a single run");
    if ((many_runs || !chosen_.dump.empty()) && run_.ground) throw InputError("--ground belongs to a single run");
    if ((many_runs || !chosen_.dump.empty()) && output_.show.where != DisplayChoice::kNowhere)
      throw InputError("--show belongs to a single run");
    if ((many_runs || !chosen_.dump.empty()) && run_.keep_trace) throw InputError("--trace belongs to a single run");
    if (chosen_.profile && (!studies_.study.empty() || studies_.endurance_minutes))
      throw InputError("--phone belongs to a single run, to --suite or to pocket-ptam budget");
    if (studies_.study == "model") return run_model_study();
    if (studies_.study == "desktop") return run_desktop_study();
    if (studies_.suite) return run_suite();
    const bool many_scenes = studies_.study == "culling" || studies_.study == "harsh" ||
                             studies_.study == "stretches" || studies_.study == "camera" ||
                             studies_.study == "doubts" || studies_.study == "reach";
    if (chosen_.stories.size() + chosen_.scenes.size() > 1 && !many_scenes)
      throw InputError("several --story or --scene belong to --suite");
    choose_sequence();
    const auto exit_code = [](bool good) { return good ? kExitOk : kExitBroken; };
    if (studies_.study == "culling")
      return exit_code(laboratory::run_culling_study(exploring<laboratory::CullingStudyOptions>(60)));
    if (studies_.study == "harsh")
      return exit_code(laboratory::run_harsh_study(exploring<laboratory::HarshStudyOptions>(0)));
    if (studies_.study == "stretches")
      return exit_code(laboratory::run_stretch_study(exploring<laboratory::StretchStudyOptions>(24)));
    if (studies_.study == "camera")
      return exit_code(laboratory::run_camera_study(exploring<laboratory::CameraStudyOptions>(0)));
    if (studies_.study == "doubts")
      return exit_code(laboratory::run_doubt_study(exploring<laboratory::DoubtStudyOptions>(0)));
    if (studies_.study == "reach")
      return exit_code(laboratory::run_reach_study(exploring<laboratory::ReachStudyOptions>(0)));
    if (studies_.study == "init") return run_start_study();
    if (!studies_.study.empty())
      throw InputError("--study " + studies_.study +
                       ": there are init, culling, harsh, stretches, model, camera, doubts, reach and desktop");
    if (studies_.many) throw InputError("--seeds and --jobs belong to --suite or --study");
    if (studies_.endurance_minutes) return run_endurance();
    return run_once();
  }

 private:
  // What is told of the camera, whatever it sees.
  void choose_phone() {
    sim::PhoneOptions& phone = chosen_.phone;
    adjust(&phone);
    if (!chosen_.readout.empty()) {
      const Readout parsed = parse_readout(chosen_.readout);
      phone.readout_axis = parsed.axis;
      phone.readout_s = parsed.seconds;
    }
    phone.noise = !chosen_.no_noise;
    if (chosen_.frames_per_s) phone.frames_per_s = *chosen_.frames_per_s;
  }

  void adjust(sim::PhoneOptions* phone) const {
    if (chosen_.profile) laboratory::use_camera(*chosen_.profile, phone);
    if (chosen_.duration_s) phone->duration_s = *chosen_.duration_s;
    if (chosen_.exposure_s) phone->exposure_s = *chosen_.exposure_s;
    if (chosen_.drop_probability) phone->drop_probability = *chosen_.drop_probability;
    sim::add_harshness(chosen_.harsh, &phone->harsh);
  }

  void adjust_story(sim::PhoneOptions* phone) const {
    adjust(phone);
    if (!chosen_.readout.empty()) {
      phone->readout_axis = chosen_.phone.readout_axis;
      phone->readout_s = chosen_.phone.readout_s;
    }
    phone->noise = chosen_.phone.noise;
    phone->even_readout = chosen_.phone.even_readout;
    if (chosen_.frames_per_s) phone->frames_per_s = *chosen_.frames_per_s;
  }

  // The scene or the story of all but the suite.
  void choose_sequence() {
    sim::PhoneOptions& phone = chosen_.phone;
    if (!chosen_.scenes.empty()) phone.scene = chosen_.scenes.front();
    if (!chosen_.stories.empty()) {
      sim::PhoneOptions told = sim::phone_for_story(chosen_.stories.front(), phone.seed);
      adjust_story(&told);
      phone = told;
    }
  }

  int run_model_study() const {
    laboratory::ModelStudyOptions options;
    options.stories = chosen_.stories;
    options.seeds = studies_.seeds;
    options.jobs = studies_.jobs;
    return laboratory::run_model_study(options) ? kExitOk : kExitBroken;
  }

  int run_desktop_study() const {
    laboratory::DesktopStudyOptions options;
    options.stories = chosen_.stories;
    options.seeds = studies_.seeds;
    options.jobs = studies_.jobs;
    options.adjust_story = [this](sim::PhoneOptions* phone) { adjust_story(phone); };
    options.run = run_;
    return laboratory::run_desktop_study(options) ? kExitOk : kExitBroken;
  }

  int run_suite() const {
    for (const std::string& story : chosen_.stories) {
      if (sim::is_model_story(story))
        throw InputError("--story " + story + ": is for the tracker of a known object, not for --suite");
      if (sim::is_desktop_story(story))
        throw InputError("--story " + story + ": is judged by --study desktop, not by --suite");
    }
    laboratory::SuiteOptions options;
    options.stories = chosen_.stories;
    options.scenes = chosen_.scenes;
    if (options.stories.empty() && options.scenes.empty()) {
      for (const sim::StoryKind& kind : sim::stories()) options.stories.push_back(kind.name);
    }
    options.seeds = studies_.seeds;
    options.jobs = studies_.jobs;
    if (!studies_.shard.empty()) options.shard = laboratory::parse_shard(studies_.shard);
    options.compare = studies_.compare;
    options.phone = chosen_.phone;
    options.adjust_story = [this](sim::PhoneOptions* phone) { adjust_story(phone); };
    options.run = run_;
    options.out = output_.out.empty() ? "out/suite" : output_.out;
    options.command = command_line_;
    options.version = PPTAM_VERSION;
    if (chosen_.duration_s) options.repeat_options += format(" --duration %g", *chosen_.duration_s);
    if (chosen_.exposure_s) options.repeat_options += format(" --exposure %g", *chosen_.exposure_s);
    if (chosen_.profile) options.repeat_options += " --phone " + shell_word(chosen_.profile->name);
    if (run_.profile == SystemProfile::kTiny) options.repeat_options += " --profile tiny";
    if (chosen_.drop_probability) options.repeat_options += format(" --drop %g", *chosen_.drop_probability);
    if (!chosen_.readout.empty()) options.repeat_options += " --readout " + chosen_.readout;
    if (chosen_.frames_per_s) options.repeat_options += format(" --fps %g", *chosen_.frames_per_s);
    if (chosen_.no_noise) options.repeat_options += " --no-noise";
    if (chosen_.phone.even_readout) options.repeat_options += " --even-readout";
    for (const std::string& cause : chosen_.harsh) options.repeat_options += " --harsh " + cause;
    return laboratory::run_suite(options) == 0 ? kExitOk : kExitBroken;
  }

  // Of a study of exploring runs, so long unless another length was asked for; 0: as long as a single run.
  template <class Options>
  Options exploring(double duration_s) const {
    Options options;
    options.scenes = chosen_.scenes;
    options.seeds = studies_.seeds;
    options.jobs = studies_.jobs;
    options.phone = chosen_.phone;
    if (!chosen_.duration_s && duration_s > 0) options.phone.duration_s = duration_s;
    options.run = run_;
    return options;
  }

  int run_start_study() const {
    laboratory::StudyOptions options;
    options.kinds = studies_.kinds;
    options.seeds = studies_.seeds;
    options.jobs = studies_.jobs;
    options.out = output_.out.empty() ? "out/study" : output_.out;
    options.command = command_line_;
    options.version = PPTAM_VERSION;
    return laboratory::run_study(options) == 0 ? kExitOk : kExitBroken;
  }

  int run_endurance() const {
    laboratory::EnduranceOptions options;
    options.minutes = *studies_.endurance_minutes;
    options.phone = chosen_.phone;
    options.run = run_;
    options.twice = studies_.twice;
    return laboratory::run_endurance(options) ? kExitOk : kExitBroken;
  }

  int run_once() const {
    const sim::PhoneOptions& phone = chosen_.phone;
    sim::check_phone_options(phone);
    const auto scene = std::make_shared<const sim::Scene>(sim::make_scene(phone));
    const std::unique_ptr<platform::Camera> camera = sim::make_phone_camera(phone, scene);
    if (!chosen_.dump.empty()) return dump(*camera, *scene);
    if (sim::is_model_story(phone.story)) return track_model(*camera, *scene);
    Knowledge knowledge;
    knowledge.plane_known = sim::ground_plane_known(phone.scene);
    knowledge.judge = [&](const RunLog& log, const Trajectory& truth) {
      const RollingShutter& shutter = log.camera.shutter;
      const int lines =
          shutter.axis == RollingShutter::Axis::kColumns ? log.camera.model.width : log.camera.model.height;
      const float exposed_s = std::abs(shutter.line_time_s) * static_cast<float>(lines) + log.camera.exposure_s;
      return summarise(laboratory::judge(log, truth, sim::story_of(phone, *scene), static_cast<double>(exposed_s)));
    };
    return run_and_write(*camera, run_, output_, knowledge, command_line_);
  }

  int track_model(platform::Camera& camera, const sim::Scene& scene) const {
    if (!output_.out.empty() || output_.show.where != DisplayChoice::kNowhere)
      throw InputError("--story " + chosen_.phone.story +
                       ": is judged only; for pictures --dump it and give it to pocket-ptam model");
    const laboratory::ModelJudgement judged = laboratory::judge_model_run(camera, scene.model);
    print_rows(laboratory::summarise(judged));
    return judged.to_the_end && judged.wrong == 0 ? kExitOk : kExitBroken;
  }

  int dump(platform::Camera& camera, const sim::Scene& scene) const {
    int frames = 0;
    bool begun = false;
    std::string broken;
    try {
      Progress progress;
      dump_sequence(camera, chosen_.dump, [&](int done, int total) {
        if (!begun) stop_on_signals();
        begun = true;
        frames = done;
        if (done > 0) progress.show(done, total, "written");
        return !interrupted();
      });
      broken = interruption();
    } catch (const InputError& error) {
      if (!begun) throw;
      broken = error.what();
    }
    write_model(camera, scene);
    print_line(format("%d images written to ", frames) + chosen_.dump);
    if (broken.empty()) return kExitOk;
    print_error("--dump " + chosen_.dump + ": " + broken + "; the sequence is shorter than it should be");
    return kExitBroken;
  }

  // The scene's things as scene.cao, and in scene.pos where they are in the first frame.
  void write_model(const platform::Camera& camera, const sim::Scene& scene) const {
    const std::string model = sim::model_text(scene);
    const Trajectory truth = camera.ground_truth();
    if (model.empty() || truth.empty()) return;
    write_text_atomically(std::filesystem::path(chosen_.dump) / "scene.cao", model);
    const Eigen::Matrix4d T_cw = truth.front().T_wc.inverse().matrix();
    std::string pose;
    for (int row = 0; row < 4; ++row)
      pose += format("%.9f %.9f %.9f %.9f\n", T_cw(row, 0), T_cw(row, 1), T_cw(row, 2), T_cw(row, 3));
    write_text_atomically(std::filesystem::path(chosen_.dump) / "scene.pos", pose);
  }

  std::string command_line_;
  SimChoice chosen_;
  ChosenStudies studies_;
  RunOptions run_;
  OutputOptions output_;
};

}  // namespace

Command add_sim(CLI::App& program, const std::string& command_line) {
  CLI::App* sim = program.add_subcommand("sim", "Run on the emulated phone");
  const auto command = std::make_shared<SimCommand>(command_line);
  command->add_options(sim);
  return {sim, [command] { return command->run(); }};
}

}  // namespace pptam::app
