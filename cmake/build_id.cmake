# The build id comes from git at build time, not at configure time, so that it is never stale.
# Run as a script (-P) this file writes OUTPUT; included it gives tailbeat_add_build_id().
if(CMAKE_SCRIPT_MODE_FILE)
  # A source distribution carries the id of the clone it was made in.
  if(EXISTS ${SOURCE}/carried/build_id.txt)
    file(READ ${SOURCE}/carried/build_id.txt id)
    file(CONFIGURE OUTPUT ${OUTPUT} CONTENT "#define TAILBEAT_BUILD_ID \"${id}\"\n")
    return()
  endif()
  execute_process(
    COMMAND git -C ${SOURCE} describe --always --dirty --tags
    OUTPUT_VARIABLE revision ERROR_QUIET OUTPUT_STRIP_TRAILING_WHITESPACE)
  execute_process(
    COMMAND git -C ${SOURCE} rev-parse --show-prefix
    OUTPUT_VARIABLE prefix ERROR_QUIET OUTPUT_STRIP_TRAILING_WHITESPACE)
  set(id ${VERSION})
  # A non-empty prefix means that the repository found is another one, around this folder.
  if(revision AND NOT prefix)
    set(id ${VERSION}-${revision})
  endif()
  string(SUBSTRING "${id}" 0 49 id)
  file(CONFIGURE OUTPUT ${OUTPUT} CONTENT "#define TAILBEAT_BUILD_ID \"${id}\"\n")
  return()
endif()

set(build_id_script ${CMAKE_CURRENT_LIST_FILE})

function(tailbeat_add_build_id target source)
  set(header ${PROJECT_BINARY_DIR}/build_id/build_id_generated.h)
  add_custom_target(tailbeat_build_id
    COMMAND ${CMAKE_COMMAND} -DSOURCE=${PROJECT_SOURCE_DIR} -DVERSION=${PROJECT_VERSION}
            -DOUTPUT=${header} -P ${build_id_script}
    BYPRODUCTS ${header}
    COMMENT "")
  add_dependencies(${target} tailbeat_build_id)
  set_source_files_properties(${source} PROPERTIES
    INCLUDE_DIRECTORIES ${PROJECT_BINARY_DIR}/build_id OBJECT_DEPENDS ${header})
endfunction()
