// The files of shaders/, as CMake embeds them: its text without the comments that open it is the same.
#pragma once

namespace pptam::platform::shaders {

extern const char kLens[];  // stands before kWorldVert and kLineVert
extern const char kWorldVert[];
extern const char kLineVert[];
extern const char kPictureVert[];
extern const char kShapeVert[];
extern const char kGlyphVert[];
extern const char kPlainFrag[];
extern const char kDiscFrag[];
extern const char kLineFrag[];
extern const char kPictureFrag[];
extern const char kShapeFrag[];
extern const char kGlyphFrag[];

}  // namespace pptam::platform::shaders
