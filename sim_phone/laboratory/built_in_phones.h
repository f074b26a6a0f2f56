// The files of sim_phone/profiles, as CMake embeds them.
#pragma once

#include <cstddef>

namespace pptam::laboratory {

struct BuiltInPhone {
  const char* name;  // the file's, without .yaml
  const char* yaml;
};
extern const BuiltInPhone kBuiltInPhones[];
extern const size_t kBuiltInPhoneCount;

}  // namespace pptam::laboratory
