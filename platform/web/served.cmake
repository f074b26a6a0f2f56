# FROM a script of the page TO the folder that is served: without comments and indentation, which a third of it is.
file(READ ${FROM} text)
string(REGEX REPLACE "/\\*\\*([^*]|\\*[^/])*\\*/\n?" "" text "${text}")
string(REGEX REPLACE "\n *//[^\n]*" "" text "\n${text}")
string(REGEX REPLACE "  //[^\n]*" "" text "${text}")
string(REGEX REPLACE "\n[ \n]+" "\n" text "${text}")
string(REGEX REPLACE "^\n" "" text "${text}")
file(WRITE ${TO} "${text}")
