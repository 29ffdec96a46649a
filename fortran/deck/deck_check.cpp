// The checks that the schema declares: types, ranges, missing keys, defaults.
#include "deck.h"

#include "expression.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <set>

namespace rk {

// Maximum length of a title, a name or a path [byte]
constexpr std::size_t longest_text = 4096;
// Maximum number of items of an array
constexpr std::size_t most_items = 100000;

static bool is_array(Type type) {
   return type == Type::texts || type == Type::integers || type == Type::numbers;
}

static std::string wanted(const KeySpec &key) {
   switch (key.type) {
   case Type::text:
      return key.or_number ? "a text or a number" : "a text";
   case Type::integer:
      return "an integer";
   case Type::number:
      return key.expression.empty() ? "a number" : "a number or an expression";
   case Type::boolean:
      return "true or false";
   case Type::texts:
      return "an array of texts";
   case Type::integers:
      return "an array of integers";
   default:
      if (!key.expression.empty())
         return "an array of numbers or expressions";
      return key.scalar ? "a number or an array of numbers" : "an array of numbers";
   }
}

// Why one value (for an array: one item) is invalid; "" if it is valid
static std::string refusal(const KeySpec &key, const Value &value) {
   const bool number = value.is_number();
   bool fits = false;
   switch (key.type) {
   case Type::text:
   case Type::texts:
      fits = value.kind == Value::Kind::text || (key.or_number && number);
      break;
   case Type::integer:
   case Type::integers:
      fits = value.kind == Value::Kind::integer;
      break;
   case Type::boolean:
      fits = value.kind == Value::Kind::boolean;
      break;
   default:
      fits = number || (!key.expression.empty() && value.kind == Value::Kind::text);
   }
   if (!fits)
      return std::string("must be ") + wanted(key) + ", not " + value.described();
   if (value.kind == Value::Kind::text && is_blank(value.text))
      return "must not be empty";
   // texts go through C, where a null character would end them
   if (value.kind == Value::Kind::text && value.text.find('\0') != std::string::npos)
      return "must not contain the character \\u0000";
   if (value.kind == Value::Kind::text && value.text.size() > longest_text)
      return "must not be longer than " + std::to_string(longest_text) + " bytes, not " +
             std::to_string(value.text.size());
   if (!key.choices.empty() && !(key.or_number && number)) {
      const std::string word = value.plain();
      if (!is_one_of(word, key.choices)) {
         return "must be " + std::string(key.choices.size() > 1 ? "one of " : "") +
                join(key.choices, ", ") + ", not " + value.described() +
                suggest(word, key.choices, "");
      }
   }
   if (!number)
      return "";
   const double x = value.number();
   if (!std::isfinite(x) && !(key.infinite && x > 0.0))
      return std::string("must be a ") + (key.infinite ? "positive number or inf" : "finite number") +
             ", not " + value.plain();
   if (value.kind == Value::Kind::integer &&
       (key.type == Type::integer || key.type == Type::integers) &&
       std::abs(x) > std::numeric_limits<std::int32_t>::max())
      return "must be below 2147483648 in size, not " + value.plain();
   const auto plain = [](double bound) { return Value(bound).plain(); };
   std::vector<std::string> bounds;
   if (key.min)
      bounds.push_back("at least " + plain(*key.min));
   if (key.above)
      bounds.push_back("greater than " + plain(*key.above));
   if (key.max)
      bounds.push_back("at most " + plain(*key.max));
   if (key.below)
      bounds.push_back("less than " + plain(*key.below));
   if ((key.min && x < *key.min) || (key.above && x <= *key.above) || (key.max && x > *key.max) ||
       (key.below && x >= *key.below))
      return "must be " + join(bounds, " and ") + ", not " + value.plain();
   return "";
}

// Whether one value is given for a whole array
static bool is_single(const KeySpec &key, const Value &value) {
   return value.is_number() || (!key.expression.empty() && value.kind == Value::Kind::text);
}

// Why a value is invalid, apart from lengths; "" if it is valid
static std::string refusal_of(const KeySpec &key, const Value &value) {
   if (!is_array(key.type) || (key.scalar && is_single(key, value)))
      return refusal(key, value);
   if (value.kind != Value::Kind::array)
      return "must be " + wanted(key) + ", not " + value.described();
   // an array that may be empty is empty by default
   if (value.items.empty() && key.default_toml != "[]")
      return "must not be empty";
   if (value.items.size() > most_items)
      return "must have at most " + std::to_string(most_items) + " items, not " +
             std::to_string(value.items.size());
   KeySpec item_key = key;
   item_key.type = key.type == Type::texts      ? Type::text
                   : key.type == Type::integers ? Type::integer
                                                : Type::number;
   for (std::size_t i = 0; i < value.items.size(); ++i) {
      const std::string what = refusal(item_key, value.items[i]);
      if (!what.empty())
         return "item " + std::to_string(i + 1) + " " + what;
   }
   if (key.nonzero && std::all_of(value.items.begin(), value.items.end(),
                                  [](const Value &item) { return item.number() == 0.0; }))
      return "must not be zero";
   return "";
}

static void check_values(Deck &deck, Section &section) {
   for (const auto &[key, origin] : section.unknown)
      deck.complain(origin, deck.address(section, key), unknown_key(*section.spec, key));
   for (const KeySpec &key : section.spec->keys) {
      const Value *value = section.find(key.name);
      if (!value)
         continue;
      const std::string what = refusal_of(key, *value);
      if (what.empty())
         continue;
      deck.refuse(section, key.name, what);
      section.refused.insert(key.name);
   }
   for (const std::string &key : section.refused)
      section.values.erase(key);
}


// The first condition that fails; nullptr if all hold. One that cannot be evaluated (its key is
// absent or was refused) counts as `unknown`.
static const Condition *failing(const Deck &deck, const Section &section,
                                const std::vector<Condition> &conditions, bool unknown) {
   for (const Condition &condition : conditions) {
      if (condition.values.empty()) {
         if (!deck.lookup(section, condition.key).empty() || (unknown && section.refused.count(condition.key)))
            continue;
         return &condition;
      }
      const std::string value = deck.lookup(section, condition.key);
      if (value.empty() && unknown)
         continue;
      if (!is_one_of(value, condition.values))
         return &condition;
   }
   return nullptr;
}

// The condition required and the value found instead
static std::string only_for(const Deck &deck, const Section &section, const Condition &broken) {
   if (broken.values.empty())
      return "needs " + broken.key + " as well";
   // the value of a key in an absent table cannot be given
   const std::string absent = broken.key == "linear.problem" ? "none" : "", without = "without [linear]";
   std::vector<std::string> values = broken.values;
   values.erase(std::remove(values.begin(), values.end(), absent), values.end());
   std::string wanted = values.empty() ? "" : "for " + broken.key + " = " + join(values, " or ");
   if (values.size() < broken.values.size())
      wanted += (values.empty() ? "" : " or ") + without;
   const std::string here = deck.lookup(section, broken.key);
   return "only " + wanted + "; here " + (here == absent ? without : broken.key + " = " + here);
}

static void fill_default(const Deck &deck, Section &section, const KeySpec &key) {
   std::optional<std::string> toml = key.default_toml;
   const auto holds = [&](const Choice &choice) { return !failing(deck, section, choice.when, false); };
   const auto own = std::find_if(key.default_if.begin(), key.default_if.end(), holds);
   if (own != key.default_if.end())
      toml = own->toml;
   if (toml && !section.given(key.name))
      put_default(section, key.name, *parse_value(*toml));
}

// Values allowed only with certain values of other keys
static void check_value_if(Deck &deck, const Section &section, const KeySpec &key, const Value &value) {
   const std::string word =
      key.type == Type::number && !value.is_number() ? "an expression" : value.plain();
   for (const Restriction &one : key.value_if) {
      const Condition *broken =
         is_one_of(word, one.values) ? failing(deck, section, one.when, true) : nullptr;
      if (broken)
         deck.refuse(section, key.name,
                     word + " is " + only_for(deck, section, *broken) +
                        (one.why.empty() ? "" : ": " + one.why));
   }
}

// Keys that are missing or not allowed, given the values of others; returns those complained about
static std::set<std::string> check_presence(Deck &deck, Section &section) {
   std::set<std::string> wrong;
   for (const KeySpec &key : section.spec->keys) {
      const Value *value = section.find(key.name);
      if (const Condition *broken = failing(deck, section, key.only_if, true)) {
         if (!value)
            continue;
         deck.refuse(section, key.name, only_for(deck, section, *broken));
         wrong.insert(key.name);
         continue;
      }
      if (value)
         check_value_if(deck, section, key, *value);
      if (value || section.refused.count(key.name))
         continue;
      const std::vector<Condition> &when = key.required ? key.only_if : key.required_if;
      if ((key.required || !when.empty()) && !failing(deck, section, when, false)) {
         std::string what = "missing: " + wanted(key) + " is needed";
         const Value *other = nullptr;
         if (!when.empty()) {
            what += " for " + when.front().key;
            if (when.front().values.empty())
               other = section.find(when.front().key);
            else
               what += " = " + deck.lookup(section, when.front().key);
         }
         if (!key.choices.empty())
            what += ": " + join(key.choices, ", ");
         deck.complain(other ? other->origin : section.origin, deck.address(section, key.name), what);
         wrong.insert(key.name);
      } else if (!failing(deck, section, key.only_if, false)) {
         fill_default(deck, section, key);
      }
   }
   return wrong;
}

// Keys of which at least one is needed, or only one is allowed; skips those in `wrong`
static void check_groups(Deck &deck, const Section &section, const std::set<std::string> &wrong) {
   const auto is_wrong = [&](const std::string &key) { return wrong.count(key) > 0; };
   const auto is_there = [&](const std::string &key) {
      return section.given(key) && !is_wrong(key);
   };
   const std::vector<std::string> &some = section.spec->at_least;
   if (!some.empty() && std::none_of(some.begin(), some.end(), is_there) &&
       std::none_of(some.begin(), some.end(), is_wrong))
      deck.refuse(section, "", "needs one of the keys " + join(some, ", "));
   for (const KeySpec &key : section.spec->keys) {
      for (const std::string &other : key.not_beside) {
         if (is_there(key.name) && is_there(other))
            deck.refuse(section, key.name, "cannot be combined with " + other);
      }
   }
}

// Arrays of numbers whose lengths or order depend on each other
static void check_series(Deck &deck, const Section &section, const KeySpec &key, const Value &value) {
   for (const std::string &name : key.as_many_as) {
      const Value *other = section.find(name);
      if (other && other->items.size() != value.items.size())
         deck.refuse(section, key.name,
                     "must have as many items as " + name + ", " + std::to_string(other->items.size()) +
                        ", not " + std::to_string(value.items.size()));
   }
   for (std::size_t i = 1; key.ascending && i < value.items.size(); ++i) {
      const Value &before = value.items[i - 1], &item = value.items[i];
      if (item.number() > before.number())
         continue;
      deck.refuse(section, key.name,
                  "must increase: item " + std::to_string(i + 1) + ", " + item.plain() + ", follows " +
                     before.plain());
      return;
   }
}

static void check_length(Deck &deck, Section &section, const KeySpec &key, Value &value) {
   int length = key.length;
   std::string because;
   if (length == unknowns_length && deck.word("linear", "problem") == "poisson") {
      length = 1;
      because = " (linear.problem = poisson)";
   } else if (length < 0) {
      length = deck.dimension();
      if (length == 0)
         return;
      because = " (scene.dimension = " + std::to_string(length) + ")";
   }
   if (key.scalar && is_single(key, value)) {
      Value array(std::vector<double>{}, value.origin);
      // a single number does not apply to all unknowns
      array.items.assign(key.length == unknowns_length ? 1 : std::max(length, 1), value);
      value = array;
   }
   if (length == any_length || value.items.size() == static_cast<std::size_t>(length))
      return;
   deck.refuse(section, key.name,
               "must have " + std::to_string(length) + (length == 1 ? " item" : " items") + because + ", not " +
                  std::to_string(value.items.size()));
   section.refused.insert(key.name);
}

// Names of tables to which values refer, and values that must be unique
struct Names {
   std::map<std::string, std::set<std::string>> known;         // by table
   std::map<const KeySpec *, std::map<std::string, Origin>> taken; // first place of each value
};

static void check_names(Deck &deck, Section &section, const KeySpec &key, const Value &value,
                        Names &names) {
   if (!key.refers_to.empty()) {
      if (names.known.count(key.refers_to) == 0) {
         for (Section *entry : deck.entries(key.refers_to))
            names.known[key.refers_to].insert(entry->text(entry->spec->named_by));
      }
      if (names.known[key.refers_to].count(value.text) == 0) {
         std::vector<std::string> there;
         for (Section *entry : deck.entries(key.refers_to))
            there.push_back(entry->text(entry->spec->named_by));
         deck.refuse(section, key.name,
                     "no [[" + key.refers_to + "]] is named " + quoted(value.text) +
                        suggest(value.text, there, "there are:"));
      }
   }
   if (key.unique || section.spec->named_by == key.name) {
      const auto [earlier, first] = names.taken[&key].emplace(value.plain(), value.origin);
      if (!first)
         deck.refuse(section, key.name,
                     value.described() + " is already used by " + deck.where(earlier->second));
   }
}

// Names that an expression may use in this many dimensions, in the order of messages
static std::vector<std::string> names_of(const std::string &kind, int dimension) {
   std::vector<std::string> names;
   for (const std::string &name : expression_names()) {
      const bool plane = name == "y" || name == "ny" || name == "r" || name == "theta";
      if ((plane && dimension < 2) || (name.back() == 'z' && dimension < 3) ||
          (name == "t" && kind != "time") || (name[0] == 'n' && kind != "surface"))
         continue;
      names.push_back(name);
   }
   return names;
}

// Whether texts given for numbers are expressions
static void check_expression(Deck &deck, const Section &section, const KeySpec &key, Value &value) {
   if (deck.dimension() == 0)
      return;
   // without motion there is no time
   const std::string kind =
       key.expression == "time" && deck.entries("dynamics").empty() ? "place" : key.expression;
   std::vector<std::string> names;
   if (kind == "energy") {
      for (const KeySpec &other : section.spec->keys) {
         if (other.type == Type::number && other.expression.empty() && section.values.count(other.name))
            names.push_back(other.name);
      }
   } else {
      names = names_of(kind, deck.dimension());
   }
   const auto check = [&](const Value &one, const std::string &which) {
      if (one.kind != Value::Kind::text)
         return;
      const std::string fault = kind == "energy" ? energy_tape(one.text, names).fault
                                                 : expression_fault(one.text, names);
      if (!fault.empty())
         deck.refuse(section, key.name, which + quoted(one.text) + " " + fault);
   };
   check(value, "");
   // with an expression the numbers are texts
   if (std::any_of(value.items.begin(), value.items.end(), [](const Value &item) { return !item.is_number(); })) {
      for (Value &item : value.items) {
         if (item.is_number())
            item = Value(exactly(item.number()));
      }
   }
   for (std::size_t i = 0; i < value.items.size(); ++i)
      check(value.items[i], "item " + std::to_string(i + 1) + ", ");
}

void check_schema(Deck &deck) {
   for (const TableSpec &spec : schema()) {
      if (spec.many || !deck.entries(spec.name).empty())
         continue;
      const bool fillable = std::none_of(spec.keys.begin(), spec.keys.end(),
                                         [](const KeySpec &key) { return key.required; });
      if (spec.required && !deck.misshapen.count(spec.name))
         deck.complain({}, spec.name, "missing: the table " + spec.title() + " is needed");
      if (fillable)
         deck.add(spec, {});
   }
   for (Section &section : deck.sections)
      check_values(deck, section);
   choose_form(deck);
   choose_title(deck);
   for (Section &section : deck.sections) {
      for (const KeySpec &key : section.spec->keys) {
         if (key.only_if.empty())
            fill_default(deck, section, key);
      }
   }
   for (Section &section : deck.sections) {
      if (const Condition *broken = failing(deck, section, section.spec->only_if, true))
         deck.refuse(section, "", only_for(deck, section, *broken));
      check_groups(deck, section, check_presence(deck, section));
   }
   Names names;
   for (Section &section : deck.sections) {
      for (const KeySpec &key : section.spec->keys) {
         const auto found = section.values.find(key.name);
         if (found == section.values.end())
            continue;
         if (is_array(key.type))
            check_length(deck, section, key, found->second);
         else
            check_names(deck, section, key, found->second, names);
         if (!key.expression.empty() && !section.refused.count(key.name))
            check_expression(deck, section, key, found->second);
      }
      for (const std::string &key : section.refused)
         section.values.erase(key);
      for (const KeySpec &key : section.spec->keys) {
         if (const Value *value = section.find(key.name))
            check_series(deck, section, key, *value);
      }
   }
}

} // namespace rk
