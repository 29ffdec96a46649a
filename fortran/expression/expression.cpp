// Expressions by muParser, compiled once for each text and thread.
#include "expression.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <unordered_map>

#include <muParser.h>

namespace rk {

// Compiled expressions that a thread keeps
constexpr std::size_t most_kept = 256;

constexpr std::size_t name_count = 9;

const std::vector<std::string> &expression_names() {
   static const std::vector<std::string> names = {"x", "y", "z", "r", "theta", "t", "nx", "ny", "nz"};
   return names;
}

static double both(double a, double b) { return a != 0.0 && b != 0.0 ? 1.0 : 0.0; }
static double either(double a, double b) { return a != 0.0 || b != 0.0 ? 1.0 : 0.0; }
static double negated(double a) { return a == 0.0 ? 1.0 : 0.0; }

namespace {

struct Compiled {
   std::array<double, name_count> place{};
   mu::Parser parser;

   Compiled(const std::string &text, const std::vector<std::string> &names) {
      parser.ClearConst();
      parser.DefineConst("pi", std::acos(-1.0));
      parser.DefineOprt("and", both, mu::prLAND, mu::oaLEFT);
      parser.DefineOprt("or", either, mu::prLOR, mu::oaLEFT);
      parser.DefineFun("not", negated);
      const std::vector<std::string> &all = expression_names();
      for (const std::string &name : names) {
         const auto at = static_cast<std::size_t>(
            std::find(all.begin(), all.end(), name) - all.begin());
         parser.DefineVar(name, &place.at(at));
      }
      parser.SetExpr(text);
   }
};

} // namespace

// "one of x, y, pi and the functions sin, ..."
static std::string known(const Compiled &compiled, const std::vector<std::string> &names) {
   std::string list;
   for (const std::string &name : names)
      list += name + ", ";
   list += "pi; functions are ";
   bool first = true;
   for (const auto &[name, unused] : compiled.parser.GetFunDef()) {
      list += (first ? "" : ", ") + name;
      first = false;
   }
   return list;
}

// A single = would set a name; elsewhere it is part of ==, !=, <= or >=
static std::size_t assignment(const std::string &text) {
   for (std::size_t i = 0; i < text.size(); ++i) {
      if (text[i] != '=')
         continue;
      const bool pair = i + 1 < text.size() && text[i + 1] == '=';
      const bool second = i > 0 && std::string("=!<>").find(text[i - 1]) != std::string::npos;
      if (!pair && !second)
         return i;
      if (pair)
         ++i;
   }
   return std::string::npos;
}

std::string expression_fault(const std::string &text, const std::vector<std::string> &names) {
   const auto at = [](std::size_t position) {
      return " at position " + std::to_string(position + 1);
   };
   if (text.find('"') != std::string::npos)
      return "is no expression: a text in quotes" + at(text.find('"'));
   if (assignment(text) != std::string::npos)
      return "is no expression: = sets a value" + at(assignment(text)) + ", == compares";
   try {
      Compiled compiled(text, names);
      compiled.parser.Eval();
      if (compiled.parser.GetNumResults() > 1)
         return "is no expression: several values with commas between, one is needed";
      return "";
   } catch (const mu::Parser::exception_type &fault) {
      const auto position = static_cast<std::size_t>(std::max(fault.GetPos(), 0));
      Compiled empty("0", names);
      switch (fault.GetCode()) {
      case mu::ecUNASSIGNABLE_TOKEN:
         return "is no expression: unknown name '" + fault.GetToken() + "'" + at(position) +
                "; names are " + known(empty, names);
      case mu::ecUNEXPECTED_EOF:
         return "is no expression: it ends where a value is missing";
      case mu::ecMISSING_PARENS:
         return "is no expression: a parenthesis is not closed";
      case mu::ecUNEXPECTED_OPERATOR:
      case mu::ecUNEXPECTED_PARENS:
      case mu::ecUNEXPECTED_VAL:
      case mu::ecUNEXPECTED_VAR:
      case mu::ecUNEXPECTED_FUN:
      case mu::ecUNEXPECTED_ARG:
         return "is no expression: unexpected '" + fault.GetToken() + "'" + at(position) +
                (text.find("**") != std::string::npos ? "; a power is written x^2" : "");
      default: {
         std::string what = fault.GetMsg();
         if (!what.empty() && what.back() == '.')
            what.pop_back();
         return "is no expression: " + what;
      }
      }
   }
}

bool expression_uses(const std::string &text, const std::string &name) {
   try {
      Compiled compiled(text, expression_names());
      return compiled.parser.GetUsedVar().count(name) > 0;
   } catch (const mu::Parser::exception_type &) {
      return false;
   }
}

} // namespace rk

extern "C" {

// Value of an expression; not a number where it is none
double rk_expression_value(const char *text, const double *place) {
   thread_local std::unordered_map<std::string, std::unique_ptr<rk::Compiled>> kept;
   try {
      auto found = kept.find(text);
      if (found == kept.end()) {
         if (kept.size() >= rk::most_kept)
            kept.clear();
         found = kept.emplace(text, std::make_unique<rk::Compiled>(text, rk::expression_names()))
                    .first;
      }
      std::copy(place, place + rk::name_count, found->second->place.begin());
      return found->second->parser.Eval();
   } catch (const mu::Parser::exception_type &) {
      return std::numeric_limits<double>::quiet_NaN();
   }
}

int rk_expression_uses(const char *text, const char *name) {
   return rk::expression_uses(text, name) ? 1 : 0;
}

} // extern "C"
