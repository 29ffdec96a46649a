// Texts in the place of numbers: expressions in what the schema allows there.
#include "deck.h"

#include "expression.h"

namespace rk {

// Names that mean something in this many dimensions
static std::vector<std::string> names_of(const std::string &kind, int dimension) {
   std::vector<std::string> names = {"x"};
   if (dimension > 1)
      names.insert(names.end(), {"y", "r", "theta"});
   if (dimension > 2)
      names.push_back("z");
   if (kind == "time")
      names.push_back("t");
   if (kind == "surface") {
      names.push_back("nx");
      if (dimension > 1)
         names.push_back("ny");
      if (dimension > 2)
         names.push_back("nz");
   }
   return names;
}

void check_expression(Deck &deck, const Section &section, const KeySpec &key, const Value &value) {
   const Section *scene = deck.single("scene");
   const Value *dimension = scene ? scene->find("dimension") : nullptr;
   if (!dimension)
      return;
   // the time is of no meaning where nothing moves
   const std::string kind =
       key.expression == "time" && deck.entries("dynamics").empty() ? "place" : key.expression;
   const std::vector<std::string> names = names_of(kind, static_cast<int>(dimension->integer));
   const auto check = [&](const Value &one, const std::string &which) {
      const std::string fault =
          one.kind == Value::Kind::text ? expression_fault(one.text, names) : "";
      if (!fault.empty())
         deck.complain(value.origin, deck.address(section, key.name),
                       which + quoted(one.text) + " " + fault);
   };
   check(value, "");
   for (std::size_t i = 0; i < value.items.size(); ++i)
      check(value.items[i], "item " + std::to_string(i + 1) + ", ");
}

} // namespace rk
